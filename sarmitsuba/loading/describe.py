"""Radar and settings of a scene, read from the elements of sensor, film and integrator."""

from dataclasses import dataclass, replace

from sarmitsuba.core.errors import RadarError, SceneError
from sarmitsuba.core.parameters import did_you_mean, fill_description
from sarmitsuba.effects.effect import switchable_effects
from sarmitsuba.loading import tables
from sarmitsuba.loading.elements import Element
from sarmitsuba.loading.library import list_radars
from sarmitsuba.loading.overrides import Overrides
from sarmitsuba.radar.description import RadarInput
from sarmitsuba.scene.settings import TraceSettings

# parameters of the place of the file's origin on the Earth
_ANCHOR = ("latitude_deg", "longitude_deg", "height")


@dataclass(frozen=True, eq=False)
class Described:
    """Radar and settings of a scene.

    Parameters
    ----------
    radar : of sensor and film
    settings : of the integrator
    """

    radar: RadarInput
    settings: TraceSettings


def describe(root: Element, radar_root: Element | None, overrides: Overrides, label: str) -> Described:
    """Read sensor, film and integrator of a scene, or of the radar file that replaces them.

    Parameters
    ----------
    root, radar_root : of the scene and, if there is one, of the radar file
    overrides : of plugin parameters
    label : of the scene, start of an error

    Raises
    ------
    SceneError, RadarError : something is missing, misplaced or out of bounds
    """
    sensor, film = _sensor(root, radar_root, label)
    radar = _radar_input(sensor, film, overrides)
    values, _ = overrides.read(_integrator(root, radar_root), tables.INTEGRATOR)
    effects = {effect.name: values.pop(effect.name) for effect in switchable_effects()}
    values["gridding_width"] = values["gridding_width"] or radar.film.gridding_width
    return Described(radar, fill_description(TraceSettings(), {**values, "effects": effects}))


def _sensor(root: Element, radar_root: Element | None, label: str) -> tuple[Element, Element | None]:
    """Sensor and film: the radar file's where it has them, else the scene's."""
    for shape in radar_root.of_kind("shape") if radar_root is not None else ():
        raise SceneError(
            f"{shape.where}: a radar file holds sensor, film and integrator only; move the shape to the scene"
        )
    found = [_pick_sensor(tree) for tree in (radar_root, root) if tree is not None]
    sensor = next((s for s in found if s is not None), None)
    if sensor is not None and found[-1] is not None and sensor is not found[-1]:
        # the place on the Earth belongs to the geometry, not to the radar file
        place = {name: value for name, value in found[-1].values.items() if name in _ANCHOR}
        sensor = replace(sensor, values={**sensor.values, **place})
    if sensor is None:
        others = [e.plugin for e in root.of_kind("sensor")]
        has = f" (only {', '.join(others)})" if others else ""
        has += next(filter(None, (did_you_mean(name, (tables.SENSOR.plugin,)) for name in others)), "")
        raise RadarError(
            f"{label}: no sar_antenna sensor{has}; add one, or lay a radar over the scene with --radar RADAR.xml or "
            f"a shipped one: --radar {', '.join(entry.name for entry in list_radars())}; in Python radar=..."
        )
    film = sensor.child("film")
    if radar_root is not None:
        film = radar_root.child("film") or film
    if film is not None and film.plugin != tables.FILM.plugin:
        raise RadarError(f'{film.where}: film type "{film.plugin}" cannot record echoes; use range_film')
    return sensor, film


def _pick_sensor(root: Element) -> Element | None:
    return next((s for s in root.of_kind("sensor") if s.plugin == tables.SENSOR.plugin), None)


def _radar_input(sensor: Element, film: Element | None, overrides: Overrides) -> RadarInput:
    """Validate the parameters of a sensor and its film (None: all defaults)."""
    nested = tuple(name for name, child in sensor.children if child.kind in ("film", "sampler", "medium"))
    if film is None:
        file = sensor.where.partition(":")[0]
        film = Element("film", tables.FILM.plugin, "", f"{file}: film range_film", sensor.folder, {})
    filters = tuple(name for name, child in film.children if child.kind == "reconstructionfilter")
    return RadarInput.read(
        overrides.given(sensor, tables.SENSOR, skip=nested),
        overrides.given(film, tables.FILM, skip=filters),
        sensor.where,
        film.where,
        sensor.folder,
    )


def _integrator(root: Element, radar_root: Element | None) -> Element:
    """The ``sar_path`` element, or one with all defaults (integrators for images of light are ignored)."""
    for tree in (radar_root, root):
        for element in tree.of_kind("integrator") if tree is not None else ():
            if element.plugin == tables.INTEGRATOR.plugin:
                return element
    return Element("integrator", tables.INTEGRATOR.plugin, "", "integrator sar_path", root.folder, {})
