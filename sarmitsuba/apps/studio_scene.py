"""3-D view of the studio as arrays: bodies, radar on its track, beam, image on the ground.

The radar is drawn closer: its distance from the aim point is reduced to a few diameters of the scene, in its true
direction.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from sarmitsuba.core.arrays import F64, I32, U8
from sarmitsuba.radar.radar import Radar
from sarmitsuba.scene.scene import Scene
from sarmitsuba.signal.image import SarImage

# displayed distance of the radar, in diameters of the scene
NEARNESS = 1.1
# sides of the beam
SIDES = 48
# height of the image above the ground over the scene's diameter, which avoids flicker
LIFT = 1e-3
# red, green, blue of successive surfaces
COLOURS = (
    (176, 158, 130),
    (150, 160, 175),
    (190, 130, 110),
    (120, 150, 120),
    (165, 140, 180),
    (200, 185, 120),
)


@dataclass(frozen=True, eq=False)
class Body:
    """Triangles of one material.

    Parameters
    ----------
    name : of the material
    vertices : (n, 3) float64, m, scene frame
    faces : (m, 3) int32
    colour : red, green, blue, 0 to 255
    """

    name: str
    vertices: F64
    faces: I32
    colour: tuple[int, int, int]


@dataclass(frozen=True, eq=False)
class BeamCone:
    """Radar and its illuminated area at one pulse.

    Parameters
    ----------
    antenna : (3,) m, scene frame, drawn closer
    middle : (3,) m, intersection of the boresight with the image plane
    rim : (SIDES, 3) m, outline of the imaged area, moved with the boresight
    """

    antenna: F64
    middle: F64
    rim: F64

    @property
    def mesh(self) -> tuple[F64, I32]:
        """Cone from the antenna to the rim: vertices (SIDES + 1, 3) m and faces."""
        i = np.arange(SIDES, dtype=np.int32)
        faces = np.stack([np.full(SIDES, SIDES, dtype=np.int32), i, np.roll(i, -1)], axis=1)
        return np.concatenate([self.rim, self.antenna[None]]), faces


@dataclass(frozen=True, eq=False)
class Plane:
    """Picture on a plane of the scene.

    Parameters
    ----------
    colours : (rows, columns, 3) uint8; rows increase against ``up``, columns along ``right``
    center, right, up : (3,) m and unit vectors, scene frame
    width, height : m
    """

    colours: U8
    center: F64
    right: F64
    up: F64
    width: float
    height: float


def bodies(scene: Scene) -> Iterator[Body]:
    """Triangles of a scene by material."""
    geometry = scene.geometry
    used = np.unique(geometry.face_material)
    for i, material in enumerate(used):
        faces = geometry.faces[geometry.face_material == material]
        vertices, index = np.unique(faces, return_inverse=True)
        yield Body(
            scene.materials[material].name,
            geometry.vertices[vertices],
            index.reshape(-1, 3).astype(np.int32),
            COLOURS[i % len(COLOURS)],
        )


def beam_at(scene: Scene, share: float) -> BeamCone:
    """Radar and beam at a fraction of the aperture, 0 at its first pulse and 1 at its last."""
    radar, image = scene.radar, scene.image
    pulse = round(share * (radar.track.n_pulses - 1))
    target = np.array([image.center_x, image.center_y, image.height])
    shrink = _shrink(scene)
    position, boresight = radar.track.position[pulse], radar.pointing.boresight[pulse]
    hit = position + boresight * ((image.height - position[2]) / min(boresight[2], -1e-9))
    middle = radar.aim_point + shrink * (hit - radar.aim_point)
    angle = np.linspace(0.0, 2.0 * np.pi, SIDES, endpoint=False)
    half = 0.5 * np.array([image.extent_azimuth, image.extent_range])
    outline = (
        half[0] * np.cos(angle)[:, None] * radar.track.along + half[1] * np.sin(angle)[:, None] * radar.across
    )
    return BeamCone(
        radar.aim_point + shrink * (position - radar.aim_point),
        middle,
        outline + middle + target - _aim(radar, image.height),
    )


def track_shown(scene: Scene) -> F64:
    """Displayed track, drawn closer, (n_pulses, 3) m, scene frame."""
    radar = scene.radar
    return np.asarray(radar.aim_point + _shrink(scene) * (radar.track.position - radar.aim_point))


def image_plane(image: SarImage, grey: U8, diameter: float) -> Plane:
    """Image as a picture on the ground.

    Parameters
    ----------
    image : on a ground grid
    grey : (n_azimuth, n_range) uint8, brightness of its pixels
    diameter : m, of the scene
    """
    grid = image.grid
    corner = grid.origin + grid.azimuth.mean() * grid.along + grid.range.mean() * grid.across
    center = np.array([corner[0], corner[1], grid.height + LIFT * diameter])
    colours = np.repeat(grey[::-1, :, None], 3, axis=2)
    right = grid.across
    if np.cross(right, grid.along)[2] < 0.0:  # looking left: seen from above, range grows to the left
        right, colours = -right, colours[:, ::-1]
    width = float(np.ptp(grid.range)) + grid.range_spacing
    height = float(np.ptp(grid.azimuth)) + grid.azimuth_spacing
    return Plane(np.ascontiguousarray(colours), center, right, grid.along, width, height)


def _aim(radar: Radar, height: float) -> F64:
    """Intersection of the line of sight at mid-aperture with the image plane, m."""
    position = radar.track.center_position
    line = radar.aim_point - position
    return np.asarray(position + line * ((height - position[2]) / line[2]))


def _shrink(scene: Scene) -> float:
    """Ratio of the displayed and the true distance of the radar, at most 1."""
    radar = scene.radar
    distance = float(np.linalg.norm(radar.track.center_position - radar.aim_point))
    extent = max(scene.geometry.diameter, scene.image.extent_azimuth, scene.image.extent_range)
    return min(1.0, NEARNESS * extent / distance)
