"""Volumes of a scene file: parameters of the BSDF ``radar_volume``, and the shapes that have it."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from sarmitsuba.core.arrays import F64, I32
from sarmitsuba.core.errors import SceneError
from sarmitsuba.core.parameters import Param, ParamTable, Value, float_value, string_value
from sarmitsuba.core.units import power_from_db
from sarmitsuba.loading.elements import Element
from sarmitsuba.loading.overrides import Overrides
from sarmitsuba.loading.shapes import MeshReader, Placed
from sarmitsuba.scene.materials.change import CHANGE, change_of
from sarmitsuba.scene.materials.vegetation.canopy import (
    CANOPIES,
    Canopy,
    Constituent,
    Orientation,
    VolumeMedium,
    water_cloud,
)
from sarmitsuba.scene.materials.vegetation.plant_pieces import Leaf, Stick
from sarmitsuba.scene.mesh.closed import enclosed_volume, is_closed
from sarmitsuba.scene.volumes import Volume

# sagitta of a spherical volume's facets over its radius, independent of the wavelength
SAGITTA_OVER_RADIUS = 0.01
_CLOUD = ("sigma_v_h_db", "sigma_v_v_db", "extinction_h", "extinction_v", "volume_cross_ratio_db")


def _pieces(kind: str, words: str, sizes: tuple[Param, Param], moisture: float) -> tuple[Param, ...]:
    """Parameters of leaves or sticks."""
    tilt = "most frequent tilt of their axes from the vertical; the axis of a leaf is its normal"
    spread = "standard deviation of the tilt; 0: all directions equally frequent"
    return (
        Param(
            f"{kind}_density",
            "float",
            0.0,
            f"{words} per cubic metre, in addition to those of a preset",
            "1/m^3",
            0.0,
            1e7,
        ),
        *sizes,
        Param(f"{kind}_moisture", "float", moisture, "mass of water over their total mass", "", 0.0, 0.7),
        Param(f"{kind}_tilt_deg", "float", 0.0, tilt, "deg", 0.0, 90.0),
        Param(f"{kind}_spread_deg", "float", 0.0, spread, "deg", 0.0, 90.0),
    )


_LEAVES = _pieces(
    "leaf",
    "leaves",
    (
        Param("leaf_radius", "float", 0.03, "radius of a leaf", "m", 0.0, 1.0, True),
        Param("leaf_thickness", "float", 2e-4, "thickness of a leaf", "m", 0.0, 0.01, True),
    ),
    0.65,
)
_STICKS = _pieces(
    "stick",
    "needles, twigs or branches",
    (
        Param("stick_radius", "float", 0.002, "radius of a stick", "m", 0.0, 0.1, True),
        Param("stick_length", "float", 0.2, "length of a stick", "m", 0.0, 5.0, True),
    ),
    0.5,
)

RADAR_VOLUME = ParamTable(
    plugin="radar_volume",
    element="bsdf",
    doc="On a closed shape (sphere, cube, closed mesh): a volume that waves penetrate and that scatters them. A "
    "`preset`, leaves and sticks by `leaf_density` and `stick_density`, or a water cloud by its coefficients in one "
    "band, `sigma_v_h_db` and `extinction_h`.",
    params=(
        Param(
            "preset",
            "string",
            "",
            "vegetation by name, at the radar's frequency",
            choices=lambda: tuple(sorted(CANOPIES.names)),
        ),
        Param(
            "relative_density",
            "float",
            1.0,
            "density of scatterers relative to the preset",
            "",
            0.0,
            100.0,
            True,
        ),
        *_LEAVES,
        *_STICKS,
        Param(
            "sigma_v_h_db",
            "float",
            None,
            "radar cross section per volume of a water cloud, HH",
            "dB",
            -100.0,
            30.0,
        ),
        Param(
            "sigma_v_v_db",
            "float",
            None,
            "radar cross section per volume of a water cloud, VV; automatic: as HH",
            "dB",
            -100.0,
            30.0,
        ),
        Param("extinction_h", "float", 0.0, "one-way power extinction of a water cloud, H", "1/m", 0.0, 1e3),
        Param(
            "extinction_v",
            "float",
            None,
            "one-way power extinction of a water cloud, V; automatic: as H",
            "1/m",
            0.0,
            1e3,
        ),
        Param(
            "volume_cross_ratio_db",
            "float",
            -8.0,
            "cross- over co-polar power of a water cloud",
            "dB",
            -300.0,
            0.0,
        ),
        Param(
            "scatterer_spacing",
            "float",
            0.0,
            "distance between the scatterers that represent the volume",
            "m",
            0.0,
            1e3,
            auto=True,
        ),
        *CHANGE,
    ),
)


@dataclass
class VolumeBook:
    """Volumes of a scene, and the medium of every BSDF.

    Parameters
    ----------
    frequency : Hz, of the media
    overrides : from the command line
    """

    frequency: float
    overrides: Overrides
    volumes: list[Volume] = field(default_factory=list)
    _media: dict[int, tuple[Element, VolumeMedium, float]] = field(default_factory=dict)

    @property
    def elements(self) -> list[Element]:
        """BSDF elements whose media are made."""
        return [element for element, _, _ in self._media.values()]

    def add_shape(self, placed: Placed, bsdf: Element, reader: MeshReader) -> None:
        """Add a shape with a ``radar_volume``; ``reader`` caches mesh files.

        Raises
        ------
        SceneError : the shape is open or moves, or the medium is not described
        """
        where, element = placed.element.where, placed.element
        if not placed.motion.still:
            raise SceneError(
                f'{where}: a radar_volume cannot move, but "{placed.name}" has a velocity; take that away'
            )
        if element.plugin == "sphere":
            radius = element.values.get("radius", 1.0)
            size = float(np.linalg.norm(placed.to_world[:3, :3], 2))
            size *= float(radius) if isinstance(radius, int | float) else 1.0
            reader = MeshReader(SAGITTA_OVER_RADIUS * size)
        vertices, faces = reader.triangles(placed)
        self.add(placed.name, vertices, faces, bsdf, where)

    def add(self, name: str, vertices: F64, faces: I32, bsdf: Element, where: str) -> None:
        """Add a mesh with a ``radar_volume``: vertices (n_v, 3) m, file frame; ``where`` starts errors."""
        if (
            id(bsdf) not in self._media
        ):  # the element is kept: a deleted one would leave its Python id to another
            values, given = self.overrides.read(bsdf, RADAR_VOLUME)
            medium = medium_of(
                bsdf.id or f"volume_{len(self._media) + 1}", values, given, self.frequency, bsdf.where
            )
            self._media[id(bsdf)] = (bsdf, medium, float_value(values, "scatterer_spacing"))
        _, medium, spacing = self._media[id(bsdf)]
        self.volumes.append(closed_volume(name, vertices, faces, medium, spacing, where))


def closed_volume(
    name: str, vertices: F64, faces: I32, medium: VolumeMedium, spacing: float, where: str
) -> Volume:
    """Volume of a closed mesh, normals outwards.

    Raises
    ------
    SceneError : the mesh is open or encloses nothing
    """
    content = enclosed_volume(vertices, faces) if len(faces) else 0.0
    if not np.isfinite(vertices).all() or not is_closed(vertices, faces) or content == 0.0:
        raise SceneError(
            f'{where}: "{name}" with a radar_volume is not closed: its {len(faces)} faces enclose no volume; take a '
            "sphere, a cube or a mesh in which every edge has two faces"
        )
    return Volume(name, vertices, faces if content > 0.0 else faces[:, ::-1].copy(), medium, spacing)


def medium_of(
    name: str, values: Mapping[str, Value | None], given: frozenset[str], frequency: float, where: str
) -> VolumeMedium:
    """Medium of validated parameters.

    Parameters
    ----------
    name : of the medium
    values, given : of every parameter of ``radar_volume``, and the names of those that were given
    frequency : Hz
    where : start of errors

    Raises
    ------
    SceneError : neither plants nor a water cloud is described, or both are
    """
    stays, days = change_of(values, given, where)
    preset, cloud = string_value(values, "preset"), [n for n in _CLOUD if n in given]
    try:
        parts = _constituents(values)
    except SceneError as error:
        raise SceneError(f"{where}: {error}") from None
    if preset:
        whole = CANOPIES[preset].denser(float_value(values, "relative_density"))
        parts = (*whole.constituents, *parts)
    elif "relative_density" in given:
        raise SceneError(f"{where}: relative_density needs a preset; name one, or leave it out")
    if parts and cloud:
        what = "preset" if preset else "leaf_density" if "leaf_density" in given else "stick_density"
        raise SceneError(f"{where}: {what} and {cloud[0]} describe the volume twice; leave one out")
    if parts:
        medium = Canopy(name, "", parts).medium(frequency)
        return replace(medium, temporal_coherence=stays, decorrelation_days=days)
    if values["sigma_v_h_db"] is None:
        raise SceneError(
            f'{where}: the volume has no content; give <string name="preset" value="deciduous_summer"/> '
            "or leaf_density, stick_density, or sigma_v_h_db and extinction_h"
        )
    level = float_value(values, "sigma_v_h_db")
    levels = (level, level if values["sigma_v_v_db"] is None else float_value(values, "sigma_v_v_db"))
    first = float_value(values, "extinction_h")
    second = first if values["extinction_v"] is None else float_value(values, "extinction_v")
    medium = water_cloud(
        name,
        (float(power_from_db(levels[0])), float(power_from_db(levels[1]))),
        (first, second),
        float(power_from_db(float_value(values, "volume_cross_ratio_db"))),
    )
    return replace(medium, temporal_coherence=stays, decorrelation_days=days)


def _constituents(values: Mapping[str, Value | None]) -> tuple[Constituent, ...]:
    """Leaves and sticks of the parameters."""
    pieces = {
        "leaf": Leaf(float_value(values, "leaf_radius"), float_value(values, "leaf_thickness")),
        "stick": Stick(float_value(values, "stick_radius"), float_value(values, "stick_length")),
    }
    found = []
    for kind, piece in pieces.items():
        density = float_value(values, f"{kind}_density")
        spread = float_value(values, f"{kind}_spread_deg") or np.inf
        if density > 0.0:
            orientation = Orientation(float_value(values, f"{kind}_tilt_deg"), spread)
            found.append(Constituent(piece, density, float_value(values, f"{kind}_moisture"), orientation))
    return tuple(found)
