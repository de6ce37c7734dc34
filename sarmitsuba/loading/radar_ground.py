"""Level ground that a scene asks for: shape ``radar_ground``, option ``--ground``."""

from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from sarmitsuba.core.arrays import F64, I32
from sarmitsuba.core.errors import SceneError
from sarmitsuba.core.parameters import Value, one_line
from sarmitsuba.loading.elements import Element
from sarmitsuba.loading.material_tables import RADAR_MATERIAL
from sarmitsuba.loading.shapes import Placed
from sarmitsuba.radar.image_request import ImageRequest
from sarmitsuba.radar.radar import Radar
from sarmitsuba.scene.geometry import Geometry
from sarmitsuba.scene.ground import DEPTH, level_rim, reach_of
from sarmitsuba.scene.mesh.tessellate import rectangle

PLUGIN, MATERIAL = "radar_ground", "material"
# distance from which two level surfaces are two, m
_APART = 1e-3
# largest coordinate and side, m
_MOST = 1e8


@dataclass(frozen=True)
class LevelGround:
    """A level square of ground.

    Parameters
    ----------
    name, where : of the shape, for notes and errors
    material : index into the scene's materials
    level : m, file frame; None: the lowest of all other scatterers, 0 without any
    extent : m, side of the square about the middle of the image; None: beyond all rays, and not counted in the extent
        of the scene
    """

    name: str
    where: str
    material: int
    level: float | None = None
    extent: float | None = None

    def height(self, geometry: Geometry, places: F64) -> float:
        """Its level beside a geometry and places (n, 3), m, in their frame without an offset."""
        if self.level is not None:
            return self.level
        lows = [*([geometry.bounds[0, 2]] if geometry.n_faces else []), *places[:, 2]]
        return float(min(lows, default=0.0))

    def triangles(
        self, geometry: Geometry, places: F64, image: ImageRequest, radar: Radar, offset: F64
    ) -> tuple[F64, I32, str]:
        """Vertices (4, 3), m, and faces (2, 3) in the file frame, and the note about them.

        Parameters
        ----------
        geometry, places : of all else, m, file frame
        image, radar : that see it, scene frame
        offset : (3,) m, of the scene frame

        Raises
        ------
        SceneError : the scene has level ground there already
        """
        level = self.height(geometry, places)
        rim = level_rim(geometry)
        above = rim.height - level if rim is not None else np.inf
        if rim is not None and (abs(above) < _APART or (self.level is None and 0.0 < above < DEPTH)):
            shape = geometry.mesh_names[int(geometry.face_mesh[rim.face[0]])]
            raise SceneError(
                f'{self.where}: "{shape}" is ground at z = {rim.height:.4g} m already; leave one of them out'
            )
        seen = replace(geometry, vertices=geometry.vertices - offset)
        side = self.extent or 2.0 * reach_of(image, radar, seen)
        vertices, faces = rectangle()
        center = np.array([image.center_x + offset[0], image.center_y + offset[1], level])
        note = f"{self.where}: laid at z = {level:.4g} m, {side:.4g} m x {side:.4g} m"
        return center + 0.5 * side * vertices, faces, note


def ground_element(material: str | Mapping[str, Value], label: str, taken: Collection[str] = ()) -> Element:
    """BSDF element of ground: the name of a material, or parameters of ``radar_material`` by name.

    It is named as its material, or ``ground`` where it has none or another one has that name (``taken``).
    """
    values = {MATERIAL: material} if isinstance(material, str) else dict(material)
    name = str(values.get(MATERIAL, ""))
    name = "ground" if not name or name in taken else name
    return Element("bsdf", RADAR_MATERIAL.plugin, name, f"{label}: ground", Path(), values)


def read_ground(placed: Placed, bsdf: Element | None) -> tuple[Element, float | None, float | None]:
    """Bsdf, level and extent of a ``radar_ground`` shape.

    Raises
    ------
    SceneError : a value is missing or out of bounds, or the shape is moved
    """
    element, values = placed.element, placed.element.values
    if not np.array_equal(placed.to_world, np.eye(4)) or not placed.motion.still:
        raise SceneError(f"{element.where}: radar_ground does not move; give its level, outside of instances")
    name = values.get(MATERIAL)
    if (name is None) == (bsdf is None):
        raise SceneError(
            f'{element.where}: give radar_ground one of a bsdf and <string name="material" value="soil"/>'
        )
    if bsdf is None:
        if not isinstance(name, str):
            raise SceneError(f"{element.where}: material = {one_line(name)} is not a name, such as soil")
        bsdf = Element(
            "bsdf", RADAR_MATERIAL.plugin, element.id, element.where, element.folder, {MATERIAL: name}
        )
    return bsdf, _number(element, "level", -_MOST), _number(element, "extent", 0.0)


def _number(element: Element, name: str, low: float) -> float | None:
    value = element.values.get(name)
    if value is None:
        return None
    if isinstance(value, bool) or not isinstance(value, int | float) or not low < value < _MOST:
        raise SceneError(
            f"{element.where}: {name} = {one_line(value)} m is not between {low:g} m and {_MOST:g} m; give a number"
        )
    return float(value)
