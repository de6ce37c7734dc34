"""BSDF ``radar_volume``: its parameters, and the shapes that have one as volumes."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from sarmitsuba.errors import SceneError
from sarmitsuba.loader.elements import Element
from sarmitsuba.loader.overrides import Overrides
from sarmitsuba.loader.shapes import MeshReader, Placed
from sarmitsuba.materials.change import CHANGE, change_of
from sarmitsuba.materials.vegetation.canopy import CANOPIES
from sarmitsuba.materials.vegetation.medium import VolumeMedium, water_cloud
from sarmitsuba.mesh.closed import enclosed_volume, is_closed
from sarmitsuba.parameters import Param, ParamTable, Value, float_value, string_value
from sarmitsuba.scene.volumes import Volume
from sarmitsuba.units import power_from_db

F64 = NDArray[np.float64]
I32 = NDArray[np.int32]

# facets of a crown that is a sphere: a hundredth of its radius from it, whatever the wavelength
SAGITTA_OVER_RADIUS = 0.01
_CLOUD = ("sigma_v_h_db", "sigma_v_v_db", "extinction_h", "extinction_v", "volume_cross_ratio_db")

RADAR_VOLUME = ParamTable(
    plugin="radar_volume",
    element="bsdf",
    doc="On a closed shape (sphere, cube, closed mesh): waves go through it, and what fills it returns them. Either a "
    "`preset`, or a cloud with the figures of one band: `sigma_v_h_db` and `extinction_h`.",
    params=(
        Param(
            "preset",
            "string",
            "",
            "vegetation by name, at the radar's frequency",
            choices=lambda: tuple(sorted(CANOPIES.names)),
        ),
        Param(
            "relative_density", "float", 1.0, "number of pieces over that of the preset", "", 0.0, 100.0, True
        ),
        Param(
            "sigma_v_h_db",
            "float",
            None,
            "radar cross section per volume, HH, of a cloud",
            "dB",
            -100.0,
            30.0,
        ),
        Param("sigma_v_v_db", "float", None, "the same, VV; automatic: as HH", "dB", -100.0, 30.0),
        Param("extinction_h", "float", 0.0, "power that a cloud takes from H on a way", "1/m", 0.0, 1e3),
        Param("extinction_v", "float", None, "the same from V; automatic: as H", "1/m", 0.0, 1e3),
        Param(
            "volume_cross_ratio_db",
            "float",
            -8.0,
            "cross- over co-polar power of a cloud",
            "dB",
            -300.0,
            0.0,
        ),
        Param(
            "scatterer_spacing",
            "float",
            0.0,
            "distance between the scatterers that stand for the volume",
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
    frequency : Hz, that media are taken at
    overrides : from the command line
    """

    frequency: float
    overrides: Overrides
    volumes: list[Volume] = field(default_factory=list)
    _media: dict[int, tuple[Element, VolumeMedium, float]] = field(default_factory=dict)

    @property
    def elements(self) -> list[Element]:
        """BSDFs whose media are known."""
        return [element for element, _, _ in self._media.values()]

    def add_shape(self, placed: Placed, bsdf: Element, reader: MeshReader) -> None:
        """Take in a shape with a ``radar_volume``; ``reader`` keeps mesh files.

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
        """Take in a mesh with a ``radar_volume``: vertices (n_v, 3) m, file frame; ``where`` starts errors."""
        if id(bsdf) not in self._media:  # the element is kept: one that is gone would leave its id to another
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
    """Volume with its normals outwards.

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
    SceneError : neither a preset nor a cloud, or both
    """
    stays, days = change_of(values, given, where)
    preset, cloud = string_value(values, "preset"), [n for n in _CLOUD if n in given]
    if preset and cloud:
        raise SceneError(f"{where}: preset and {cloud[0]} describe the volume twice; leave one out")
    if preset:
        medium = CANOPIES[preset].medium(frequency, float_value(values, "relative_density"))
        return replace(medium, name=name, temporal_coherence=stays, decorrelation_days=days)
    if values["sigma_v_h_db"] is None:
        raise SceneError(
            f'{where}: what fills the volume is not described; give <string name="preset" value="deciduous_summer"/> '
            "or sigma_v_h_db and extinction_h"
        )
    if "relative_density" in given:
        raise SceneError(
            f"{where}: relative_density is of a preset; change sigma_v_h_db and extinction_h instead"
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


__all__ = ["RADAR_VOLUME", "VolumeBook", "closed_volume", "medium_of"]
