"""A scene with changed parameters and the same geometry, for `sarmitsuba.scene.scene.Scene.replace`."""

from collections.abc import Mapping
from dataclasses import fields, replace

from sarmitsuba.core.errors import SceneError
from sarmitsuba.core.parameters import did_you_mean, fill_description
from sarmitsuba.effects.effect import switchable_effects
from sarmitsuba.loading.assemble import seen_by
from sarmitsuba.loading.tables import INTEGRATOR
from sarmitsuba.radar.description import SENSOR, RadarDescription, RadarInput
from sarmitsuba.radar.film import FILM, FilmDescription
from sarmitsuba.scene.materials.map_materials import list_with_parts
from sarmitsuba.scene.scene import Scene

# parameters that shapes and materials depend on while loading
_LOADED_FOR = ("center_frequency", "default_rms_height")


def change_scene(scene: Scene, changes: Mapping[str, object]) -> Scene:
    """A scene with other parameters of radar, film or settings; geometry and materials are shared.

    Parameters
    ----------
    scene : as loaded or built
    changes : parameters by the names of ``sar_antenna``, ``range_film`` and ``sar_path``, effects included; or ``name``

    Raises
    ------
    SceneError, RadarError : one line: an unknown name, a value out of bounds, or a parameter that loading depends on
    """
    settings = tuple(f.name for f in fields(scene.settings) if f.name != "effects")
    effects = tuple(effect.name for effect in switchable_effects())
    for name in changes:
        _check_name(scene, name, ("name", *SENSOR.names, *FILM.names, *settings, *effects))
    label = scene.path.name if scene.path else scene.name
    given = {f: getattr(scene.settings, f) for f in settings} | dict(scene.settings.effects)
    given |= {name: changes[name] for name in changes if name in (*settings, *effects)}
    read = INTEGRATOR.read(given, f"{label}: sar_path", python=True)
    out = fill_description(
        scene.settings,
        {**{f: read[f] for f in settings}, "effects": {name: read[name] for name in effects}},
    )
    seen = [name for name in changes if name in (*SENSOR.names, *FILM.names)]
    named = replace(scene, name=str(changes.get("name", scene.name)), settings=out)
    return _seen_anew(named, {name: changes[name] for name in seen}, label) if seen else named


def _check_name(scene: Scene, name: str, known: tuple[str, ...]) -> None:
    if name not in known:
        raise SceneError(f'{scene.name}: there is no parameter "{name}"{did_you_mean(name, known)}')
    if name in _LOADED_FOR:
        raise SceneError(
            f"{scene.name}: materials and curved shapes were loaded for their {name}; load the scene again with "
            f"parameters={{'{'sar_antenna' if name in SENSOR.names else 'sar_path'}.{name}': ...}}"
        )


def _seen_anew(scene: Scene, changes: Mapping[str, object], label: str) -> Scene:
    """The scene with a changed radar or film; notes about the old radar are dropped."""
    old = scene.description
    if old is None:
        raise SceneError(f"{label}: the scene holds no description of its radar; load or build it again")
    radar = RadarInput.read(
        _list_given(old.sensor, old.sensor_given) | {n: v for n, v in changes.items() if n in SENSOR.names},
        _list_given(old.film, old.film_given) | {n: v for n, v in changes.items() if n in FILM.names},
        old.where,
        old.film_where,
        old.folder,
        old.track,
        python=True,
    )
    occurring = set(scene.geometry.face_material.tolist())
    material = list_with_parts([m for i, m in enumerate(scene.materials) if i in occurring])
    before, after = (
        seen_by(label, scene.geometry, scene.places, material, each, scene.offset) for each in (old, radar)
    )
    kept = [note for note in scene.notes if note not in before[2]]
    return replace(scene, radar=after[0], image=after[1], notes=(*kept, *after[2]), description=radar)


def _list_given(description: RadarDescription | FilmDescription, names: frozenset[str]) -> dict[str, object]:
    """Parameters that were given, by name, including those of the mode."""
    values = {name: getattr(description, name) for name in names if hasattr(description, name)}
    if isinstance(description, RadarDescription):
        values |= {name: v for name, v in description.mode_parameters.items() if name in names}
    return values
