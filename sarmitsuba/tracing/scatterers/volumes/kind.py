"""Volumes of a scene that waves go through (crowns of trees, hedges, stands): their bsdf, reader and effect."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import ClassVar

import numpy as np

from sarmitsuba.core.arrays import F64, I32
from sarmitsuba.core.errors import SceneError
from sarmitsuba.core.parameters import Param, Value, float_value, string_value
from sarmitsuba.core.units import db_from_power, power_from_db
from sarmitsuba.effects.context import SceneContext
from sarmitsuba.effects.effect import EFFECTS, Assessment, Decision, Effect
from sarmitsuba.loading.elements import Element
from sarmitsuba.loading.scatterer_shapes import Reading, ShapeKind
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
from sarmitsuba.scene.mesh.facet_edges import enclosed_volume, is_closed, surface_area
from sarmitsuba.scene.scatterers import SCATTERERS, Medium, Target
from sarmitsuba.scene.scene import Scene

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


@dataclass(frozen=True, eq=False)
class Volume:
    """Closed volume filled evenly with a medium. It rests, and no surface of a scene knows of it.

    Parameters
    ----------
    name : of the shape
    vertices : (n_v, 3) float64, m, scene frame
    faces : (n_f, 3) int32, normals outwards
    medium : its filling; where volumes overlap, both fill the place
    spacing : m, distance between the scatterers that represent it; 0: from the radar's resolution
    """

    kind: ClassVar[str] = "radar_volume"

    name: str
    vertices: F64
    faces: I32
    medium: VolumeMedium
    spacing: float = 0.0

    @cached_property
    def content(self) -> float:
        """Volume, m^3."""
        return enclosed_volume(self.vertices, self.faces)

    @cached_property
    def mean_chord(self) -> float:
        """Mean chord length, four times the volume over the surface, m."""
        return 4.0 * self.content / surface_area(self.vertices, self.faces)

    @property
    def bounds(self) -> F64:
        """Lower and upper corner, (2, 3) m."""
        return np.stack([self.vertices.min(axis=0), self.vertices.max(axis=0)])

    @property
    def places(self) -> F64:
        """Corners of its surface, (n_v, 3) float64, m, scene frame."""
        return self.vertices

    @property
    def segments(self) -> F64:
        """None: it is a body."""
        return np.zeros((0, 2, 3))

    def moved(self, step: F64) -> "Volume":
        """The volume translated by (3,) m."""
        return replace(self, vertices=self.vertices + step)


class VolumeKind(ShapeKind):
    """Volumes as closed shapes with a ``radar_volume``."""

    name = Volume.kind
    title = (
        "On a closed shape (sphere, cube, closed mesh): a volume that waves penetrate and that scatters them. A "
        "`preset`, leaves and sticks by `leaf_density` and `stick_density`, or a water cloud by its coefficients in "
        "one band, `sigma_v_h_db` and `extinction_h`."
    )
    parameters = (
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
    )
    on = "a closed shape"
    plural, mechanism = "volumes", "volume"
    rank = 20
    frequencies = 1
    random = True
    needs_surface = True

    def read(self, placed: Placed, bsdf: Element, reading: Reading) -> Sequence[Volume]:
        """See :class:`ShapeKind`."""
        where, element = placed.element.where, placed.element
        if not placed.motion.still:
            raise SceneError(
                f'{where}: a radar_volume cannot move, but "{placed.name}" has a velocity; take that away'
            )
        reader = reading.reader
        if element.plugin == "sphere":
            radius = element.values.get("radius", 1.0)
            size = float(np.linalg.norm(placed.to_world[:3, :3], 2))
            size *= float(radius) if isinstance(radius, int | float) else 1.0
            reader = MeshReader(SAGITTA_OVER_RADIUS * size)
        vertices, faces = reader.triangles(placed)
        return self.read_mesh(placed.name, vertices, faces, bsdf, where, reading)

    def read_mesh(
        self, name: str, vertices: F64, faces: I32, bsdf: Element | Medium, where: str, reading: Reading
    ) -> Sequence[Volume]:
        """See :class:`ShapeKind`."""
        if isinstance(bsdf, VolumeMedium):
            return [closed_volume(name, vertices, faces, bsdf, 0.0, where)]
        assert isinstance(bsdf, Element)
        element = bsdf

        def make(number: int) -> tuple[VolumeMedium, float]:
            values, given = reading.overrides.read(element, self.table)
            medium = medium_of(
                element.id or f"volume_{number}", values, given, reading.frequency, element.where
            )
            return medium, float_value(values, "scatterer_spacing")

        return [closed_volume(name, vertices, faces, *reading.once(element, make), where)]

    def media(self, targets: Sequence[Target]) -> Sequence[VolumeMedium]:
        """See :class:`sarmitsuba.scene.scatterers.ScattererKind`."""
        return [volume.medium for volume in volumes_of(targets)]


def volumes_of(targets: Sequence[Target]) -> tuple[Volume, ...]:
    """The volumes among the scatterers of a scene."""
    return tuple(target for target in targets if isinstance(target, Volume))


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


class Vegetation(Effect):
    """Volumes; on where a shape is a volume, off leaves all volumes out."""

    name = "vegetation"
    title = "scattering and extinction of volumes"
    documentation = "volumes, such as crowns of trees: their returns and their extinction"
    off_when = "no shape has a `radar_volume`"
    off_means = "no volumes: neither their echoes nor their extinction"
    rank = 137

    def assess(self, context: SceneContext, decided: Mapping[str, Decision]) -> Assessment:
        """See the class."""
        volumes = volumes_of(context.scene.scatterers)
        if not volumes:
            return Assessment(False, "no volume", -np.inf)
        if context.scene.settings.method == "raster":
            return Assessment(False, "method raster shows surfaces only", float("nan"))
        line = context.corners[-1] - context.scene.radar.track.center_position
        cosine = float(abs(line[2]) / np.linalg.norm(line))
        # extinction along the mean path through each, and the strongest return of one square metre of volume
        depth = [float(v.medium.at(cosine)[0].mean()) * v.mean_chord for v in volumes]
        returned = max(float(v.medium.at(cosine)[1][:2].max()) * v.mean_chord for v in volumes)
        error = db_from_power(max(1.0 - np.exp(-2.0 * max(depth)), min(returned, 1.0), 1e-30))
        what = "1 volume" if len(volumes) == 1 else f"{len(volumes)} volumes"
        low, high = (10.0 / np.log(10.0) * x for x in (min(depth), max(depth)))
        span = f"{high:.1f}" if high - low < 0.1 else f"{low:.1f} to {high:.1f}"
        why = f"{what}: extinction {span} dB along a mean path"
        return Assessment(True, why, float(error))

    def without(self, scene: Scene) -> Scene:
        """Scene without its volumes."""
        return scene.without_kind(Volume.kind)


SCATTERERS.register(VolumeKind())
EFFECTS.register(Vegetation())
