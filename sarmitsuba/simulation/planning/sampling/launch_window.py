"""Launch window: the part of the scene that is lit by rays, for each sector of the track.

Segments of scatterers in the lit part are clipped to a box.
"""

from dataclasses import dataclass

import numpy as np

from sarmitsuba.core.arrays import F64, box_corners, unit_rows
from sarmitsuba.core.errors import RadarError
from sarmitsuba.radar.image_request import ImageRequest
from sarmitsuba.radar.track import Track
from sarmitsuba.scene.scene import Scene
from sarmitsuba.simulation.planning.sampling.double_bounce import (
    GRAZING,
    MOST_RAYS,
    bounce_ground,
    steep_faces,
    unlit_ground,
    visible_faces,
)
from sarmitsuba.simulation.planning.sampling.movers import find_lit_boxes, swept
from sarmitsuba.tracing.kernel.launch import LaunchFrame, frame_towards, window_of


def clip_segments(segments: F64, low: F64, high: F64) -> F64:
    """End points (m, 3) of segments (n, 2, 3) clipped to a box, by Liang and Barsky's method."""
    start, step = segments[:, 0], segments[:, 1] - segments[:, 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        a, b = (low - start) / step, (high - start) / step
    still = step == 0.0
    inside = (start >= low) & (start <= high)
    a = np.where(still, np.where(inside, -np.inf, np.inf), a)
    b = np.where(still, np.where(inside, np.inf, -np.inf), b)
    first = np.maximum(np.minimum(a, b).max(axis=1), 0.0)
    last = np.minimum(np.maximum(a, b).min(axis=1), 1.0)
    kept = first <= last
    ends = [start[kept] + t[kept, None] * step[kept] for t in (first, last)]
    return np.concatenate(ends)


# rad, rotation of the line of sight to the scene's middle over the pulses of one launch plane. Seen 10 degrees off the
# plane's normal, tubes are wider by 1.5 per cent; an edge-on plane would light nothing
SECTOR = float(np.radians(20.0))


@dataclass(frozen=True, eq=False)
class SectorFootprint:
    """Box, along and across the track, of all objects that can appear in the image from a sector of the track.

    Parameters
    ----------
    low, high : (3,) float64, m, corners along, across and up about the image's middle
    """

    low: F64
    high: F64

    @staticmethod
    def of(image: ImageRequest, away: F64, incidence: float, local: F64) -> "SectorFootprint":
        """SectorFootprint for objects at points ``local`` (n, 3), m, along the axes about the image's middle.

        Layover moves tall objects towards the radar, so the box extends farther away from it (``away``), by the height
        over the tangent of the incidence angle, and towards the radar by the same for depths.
        """
        low, high = float(local[:, 2].min()), float(local[:, 2].max())
        slope = max(np.tan(incidence), 0.1)
        far, near = max(0.0, high) / slope * away[:2], -max(0.0, -low) / slope * away[:2]
        half = np.array([0.5 * image.extent_azimuth, 0.5 * image.extent_range])
        return SectorFootprint(
            np.append(-half + np.minimum(0.0, np.minimum(far, near)), low),
            np.append(half + np.maximum(0.0, np.maximum(far, near)), high),
        )


@dataclass(frozen=True, eq=False)
class LaunchWindow:
    """Lit part of the scene, for a sector of the track.

    Parameters
    ----------
    pulses : first pulse of the sector, and the one after its last
    box : (2, 3) float64, m, scene frame; everything inside is lit at full weight
    center : (3,) float64, m, scene frame; the launch plane's centre
    frame : launch plane of the line of sight from the sector's middle
    half_x, half_y : m, half extents of the window in the plane
    taper : m, width of the taper beyond; 0 where the scene ends within the window
    incidence : rad, on level ground at the centre
    reach : m, largest distance along the track from the image's middle at which surfaces are lit at full weight
    unlit : m, width of the ground beyond the box that double bounces of tall objects in the image need, and dB, their
        largest loss without it; 0 and 0 where the box has it all
    """

    pulses: tuple[int, int]
    box: F64
    center: F64
    frame: LaunchFrame
    half_x: float
    half_y: float
    taper: float
    incidence: float
    reach: float
    unlit: tuple[float, float] = (0.0, 0.0)

    @property
    def area(self) -> float:
        """Area of the window with its taper, m^2."""
        return 4.0 * (self.half_x + self.taper) * (self.half_y + self.taper)


def launch_windows(scene: Scene) -> tuple[LaunchWindow, ...]:
    """Launch windows of the track's sectors in turn; most apertures have one sector.

    Raises
    ------
    RadarError
        When no geometry lies within the image's footprint.
    """
    return tuple(launch_window(scene, pulses) for pulses in sectors(scene))


def sectors(scene: Scene) -> list[tuple[int, int]]:
    """First pulse and the one after the last of every sector, within which the line of sight rotates by ``SECTOR``."""
    image, n = scene.image, scene.radar.track.n_pulses
    line = np.array([image.center_x, image.center_y, image.height]) - scene.radar.track.position
    line = unit_rows(line)
    starts = [0]
    while True:
        cosine = line[starts[-1] :] @ line[starts[-1]]
        beyond = np.flatnonzero(cosine < np.cos(SECTOR))
        if not beyond.size:
            break
        starts.append(starts[-1] + int(beyond[0]))
    return list(zip(starts, [*starts[1:], n], strict=True))


def launch_window(scene: Scene, pulses: tuple[int, int]) -> LaunchWindow:
    """Launch window that lights all geometry which can appear in the requested image, for a sector of the track.

    The window covers the mesh; the box also covers scatterers that are not part of the mesh and need no rays. Ground
    beside the image that mirrors rays onto tall objects in it belongs to it, up to ``MOST_RAYS`` of the window's area.

    Raises
    ------
    RadarError
        When nothing lies within the image's footprint.
    """
    radar, image = scene.radar, scene.image
    along, across = radar.track.along, radar.across
    sector = radar.track.of_pulses(slice(*pulses))
    antenna = sector.center_position
    middle = np.array([image.center_x, image.center_y, image.height])
    look = middle - antenna
    incidence = float(np.arccos(np.clip(-look[2] / np.linalg.norm(look), -1.0, 1.0)))

    # image footprint and geometry in track-aligned axes (along, across, up), relative to the image's centre
    axes = np.stack([along, across, np.array([0.0, 0.0, 1.0])])
    away = axes @ point_across(sector, look)
    found = np.zeros((0, 3))
    if len(scene.segments):
        wires = (scene.segments.reshape(-1, 3) - middle) @ axes.T
        footprint = SectorFootprint.of(image, away, incidence, wires)
        found = clip_segments(wires.reshape(-1, 2, 3), footprint.low, footprint.high)
    bounds, cut = _lit_mesh(scene, pulses, axes, away, incidence)
    if bounds is None:
        if not found.size:
            raise RadarError(_nothing_there(scene))
        bounds = np.tile(0.5 * (found.min(axis=0) + found.max(axis=0)), (2, 1))
        cut = False

    views = bounding_antennas(radar.track, pulses)
    plane = _CoveringPlane.of(bounds, axes, middle, views, antenna, sector.along)
    ground = bounce_ground(scene, axes, middle, away, incidence)
    if ground is not None:
        wider = bounds.copy()
        wider[:, :2] = np.minimum(bounds[0, :2], ground.box[0]), np.maximum(bounds[1, :2], ground.box[1])
        whole = _CoveringPlane.of(wider, axes, middle, views, antenna, sector.along)
        more = whole.half.prod() / plane.half.prod() - 1.0
        if more > MOST_RAYS:
            wider = bounds + MOST_RAYS / more * (wider - bounds)
            whole = _CoveringPlane.of(wider, axes, middle, views, antenna, sector.along)
        bounds, plane = wider, whole
    reach = float(np.abs(bounds[:, 0]).max())
    corners, frame, half = plane.corners, plane.frame, plane.half
    # five per cent of the window, at least ten resolution cells, keeps the edge lobe of the window below the clutter
    taper = max(0.05 * float(half.max()), 10.0 * radar.waveform.range_cell) if cut else 0.0
    unlit = (0.0, 0.0)
    if ground is not None:
        zone = 0.5 * np.sqrt(radar.waveform.wavelength * np.linalg.norm(look)) / np.sin(incidence)
        spare = 0.5 * taper / max(np.cos(incidence), np.cos(GRAZING))
        unlit = ground.unlit(bounds[:, :2], float(np.tan(min(incidence, GRAZING))), float(zone), float(spare))
    every = np.concatenate([corners, found @ axes + middle])
    box = np.stack([every.min(axis=0), every.max(axis=0)])
    return LaunchWindow(
        pulses, box, frame.center[0], frame, float(half[0]), float(half[1]), taper, incidence, reach, unlit
    )


@dataclass(frozen=True, eq=False)
class _CoveringPlane:
    """Launch plane that covers a box: the box's corners (8, 3) m, the frame, and half extents (2,) m."""

    corners: F64
    frame: LaunchFrame
    half: F64

    @staticmethod
    def of(bounds: F64, axes: F64, middle: F64, views: F64, antenna: F64, along: F64) -> "_CoveringPlane":
        """Plane for a box (2, 3), m, along ``axes`` about ``middle``, seen from the positions ``views``."""
        corners = box_corners(bounds) @ axes + middle
        center = 0.5 * (corners.min(axis=0) + corners.max(axis=0))
        frame = frame_towards(antenna[None], center, along)
        spans = [window_of(corners, position, frame) for position in views]
        lo = np.min([s[0] for s in spans], axis=0)
        hi = np.max([s[1] for s in spans], axis=0)
        shift = 0.5 * (lo + hi)
        center = center + frame.axis_x[0] * shift[0] + frame.axis_y[0] * shift[1]
        return _CoveringPlane(corners, LaunchFrame(center[None], frame.axis_x, frame.axis_y), 0.5 * (hi - lo))


def _lit_mesh(
    scene: Scene, pulses: tuple[int, int], axes: F64, away: F64, incidence: float
) -> tuple[F64 | None, bool]:
    """Bounds (2, 3) of the mesh that can appear in the image, about its middle, and whether the mesh extends beyond.

    None where no mesh can.
    """
    image = scene.image
    middle = np.array([image.center_x, image.center_y, image.height])
    moving = [(corners.reshape(-1, 3) - middle) @ axes.T for corners in swept(scene, pulses)]
    bodies = [(body.places - middle) @ axes.T for body in scene.bodies]
    local = np.concatenate([(scene.geometry.vertices - middle) @ axes.T, *moving, *bodies])
    if not local.size:
        return None, False
    footprint = SectorFootprint.of(image, away, incidence, local)
    i_low, i_high = footprint.low, footprint.high
    g_low, g_high = local.min(axis=0), local.max(axis=0)
    b_low, b_high = np.maximum(i_low, g_low), np.minimum(i_high, g_high)
    shown = find_lit_boxes(scene, pulses, i_low, i_high, middle, axes)
    if shown.size:  # moving out of the image, or into it
        whole = np.concatenate([shown, np.stack([b_low, b_high])] if (b_low <= b_high).all() else [shown])
        b_low, b_high = whole.min(axis=0), whole.max(axis=0)
    cut = bool((g_low[:2] < i_low[:2] - 1e-6).any() or (g_high[:2] > i_high[:2] + 1e-6).any())
    if not (b_low > b_high).any():
        return np.stack([b_low, b_high]), cut
    if len(scene.segments):
        return None, cut
    raise RadarError(_nothing_there(scene, "azimuth" if b_low[0] > b_high[0] else "range"))


def _nothing_there(scene: Scene, where: str = "") -> str:
    """Message about an image that contains no geometry."""
    image = scene.image
    cloud = scene.geometry.bounds if scene.geometry.n_faces else scene.segments.reshape(-1, 3)
    low, high = cloud.min(axis=0), cloud.max(axis=0)
    return (
        f"{scene.name}: the image ({image.extent_azimuth:g} m x {image.extent_range:g} m about "
        f"({image.center_x:g}, {image.center_y:g}) m) contains no geometry{f' of {where}' if where else ''}, which "
        f"spans x {low[0]:g} ... {high[0]:g} m, y {low[1]:g} ... {high[1]:g} m; move image_center_x, image_center_y "
        "or enlarge the image"
    )


def mirrors_outside(scene: Scene, windows: tuple[LaunchWindow, ...]) -> str:
    """Note on walls outside all launch windows that could reflect rays into a cropped image; empty without any.

    A ray reflected by a wall at the height z above the image's plane reaches the plane within z tan(incidence).
    """
    image, geometry = scene.image, scene.geometry
    corner = geometry.vertices[geometry.faces]
    steep, areas = steep_faces(scene)
    steep &= visible_faces(scene)
    center, top = corner[steep].mean(axis=1)[:, :2], corner[steep, :, 2].max(axis=1)
    outside = np.full(len(center), True)
    near = np.full(len(center), False)
    for window in windows:
        low, high = window.box[:, :2]
        gap = np.linalg.norm(np.maximum(np.maximum(low - center, center - high), 0.0), axis=1)
        outside &= gap > window.taper
        near |= gap < np.maximum(top - image.height, 0.0) * np.tan(min(window.incidence, GRAZING))
    area = float(areas[steep][outside & near].sum())
    if area == 0.0:
        return ""
    return (
        f"{scene.name}: {area:.3g} m^2 of walls beyond the image could mirror rays into it and are not lit; their "
        "returns in the image are missing: enlarge the image by the height of the buildings there to include them"
    )


def ground_outside(scene: Scene, windows: tuple[LaunchWindow, ...]) -> str:
    """Note on ground in front of tall objects that no launch window could be extended to; empty without any."""
    return unlit_ground(scene, *np.max([window.unlit for window in windows], axis=0).tolist())


def bounding_antennas(track: Track, pulses: tuple[int, int]) -> F64:
    """Positions (3, 3) at the start, middle and end of a sector, m."""
    first, end = pulses
    return np.asarray(track.position[[first, (first + end) // 2, end - 1]])


def point_across(sector: Track, look: F64) -> F64:
    """Horizontal unit vector across the flight of a sector, to the side that ``look`` points to."""
    along = sector.along
    right = np.array([along[1], -along[0], 0.0])
    return right if right @ look >= 0.0 else -right
