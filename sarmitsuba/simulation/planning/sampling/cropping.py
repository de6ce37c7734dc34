"""Taper of scatterers at known positions beyond the border of an image that is smaller than its scene."""

from dataclasses import replace

import numpy as np

from sarmitsuba.core.arrays import F64
from sarmitsuba.core.errors import RadarError
from sarmitsuba.scene.geometry import PointTarget
from sarmitsuba.scene.scene import Scene
from sarmitsuba.simulation.planning.sampling.density_plan import azimuth_cell
from sarmitsuba.simulation.planning.sampling.launch_window import point_across, sectors
from sarmitsuba.simulation.planning.sampling.movers import TIMES, azimuth_shift

# amplitude below which a scatterer is left out
_NOTHING = 1e-6


def shares(scene: Scene, points: F64) -> F64:
    r"""Amplitude factor (n,) of scatterers at points (n, 3), m, scene frame: 1 in the image, tapered to 0 beyond it.

    .. math:: a = \tfrac12 (1 + \cos(\pi \min(d / t, 1)))

    with the distance d from the image to the nearer of the scatterer and its layover position, and a taper of the width
    t (:meth:`sarmitsuba.radar.image_request.ImageRequest.fade_out`).

    Notes
    -----
    Rays have a separate taper, in the launch plane (:class:`LaunchWindow`).
    """
    return _fade_scatterers(scene, _measure_distance(scene, points[None]))


def lit_points(scene: Scene) -> tuple[tuple[PointTarget, ...], str]:
    """Ideal points that an image can show, tapered beyond it, and a note on those left out (empty if none).

    A moving point counts with all its positions during the aperture, and with those displaced by its range rate.

    Raises
    ------
    RadarError
        The image shows none of them, and the scene has nothing else.
    """
    if not scene.points:
        return (), ""
    beside = np.concatenate([_measure_distance(scene, _places(scene, point)) for point in scene.points])
    share = _fade_scatterers(scene, beside)
    kept = tuple(
        point if a == 1.0 else replace(point, rcs=point.rcs * float(a) ** 2)
        for point, a in zip(scene.points, share, strict=True)
        if a > _NOTHING
    )
    gone = np.flatnonzero(share <= _NOTHING)
    if not gone.size:
        return kept, ""
    if not kept and not scene.traced:
        raise RadarError(
            f"{scene.name}: the image ({scene.image.extent_azimuth:g} m x {scene.image.extent_range:g} m) shows none "
            f"of the {gone.size} ideal points, the nearest {beside.min():.4g} m outside it; move or enlarge it"
        )
    first = scene.points[int(gone[0])]
    place = ", ".join(f"{v:.6g}" for v in first.position + scene.offset)
    others = f" and {gone.size - 1} more" if gone.size > 1 else ""
    return kept, (
        f'{scene.name}: point_scatterer "{first.name}" at ({place}) m{others} lies {beside[gone[0]]:.4g} m beyond the '
        "image and is left out, as surfaces there are; enlarge or move the image to include it"
    )


def _places(scene: Scene, point: PointTarget) -> F64:
    """Positions of a point and its positions in the image, (k, 1, 3) m."""
    if point.motion.still:
        return point.position[None, None]
    radar = scene.radar
    times = np.linspace(radar.track.time[0], radar.track.time[-1], TIMES)
    position, velocity = point.position_at(times), point.motion.velocity_at(times)
    shown = [
        position + azimuth_shift(radar, position, velocity * kept, times)[:, None] * radar.track.along
        for kept in (np.ones(3), np.array([1.0, 1.0, 0.0]))
    ]
    return np.concatenate([position, *shown])[:, None]


def _measure_distance(scene: Scene, places: F64) -> F64:
    """Distance (n,), m, of the boxes about the positions (k, n, 3) of n scatterers from the image; 0 within it.

    A box also holds the layover positions, at the same slant range in the image plane.
    """
    image, track = scene.image, scene.radar.track
    middle = np.array([image.center_x, image.center_y, image.height])
    axes = np.stack([track.along, scene.radar.across])
    half = 0.5 * np.array([image.extent_azimuth, image.extent_range])
    found = np.full(places.shape[1], np.inf)
    for pulses in sectors(scene):
        sector = track.of_pulses(slice(*pulses))
        antenna = sector.center_position
        away = point_across(sector, middle - antenna)
        reach = (places - antenna) @ away
        drop = antenna[2] - image.height
        slant2 = reach**2 + (places[..., 2] - antenna[2]) ** 2
        over = np.sqrt(np.maximum(slant2 - drop**2, 0.0)) * np.where(reach < 0.0, -1.0, 1.0)
        local = (places - middle) @ axes.T
        every = np.concatenate([local, local + ((over - reach)[..., None] * away) @ axes.T])
        gap = np.maximum(np.maximum(-half - every.max(axis=0), every.min(axis=0) - half), 0.0)
        found = np.minimum(found, np.linalg.norm(gap, axis=-1))
    return found


def _fade_scatterers(scene: Scene, beside: F64) -> F64:
    cell = max(azimuth_cell(scene), scene.radar.waveform.range_cell)
    t = np.minimum(beside / scene.image.fade_out(cell), 1.0)
    return np.asarray(0.5 + 0.5 * np.cos(np.pi * t))
