"""Warnings about azimuth ambiguities folded into the image, with position and level of the ghost."""

import warnings
from dataclasses import dataclass

import numpy as np

from sarmitsuba.core.arrays import F64, unit_rows
from sarmitsuba.core.errors import SarmitsubaWarning
from sarmitsuba.core.units import db_from_power
from sarmitsuba.radar.swath import beam_bandwidth
from sarmitsuba.scene.geometry import PointTarget
from sarmitsuba.scene.scene import Scene
from sarmitsuba.signal.focusing.aperture_weights import direction_gain
from sarmitsuba.simulation.execution.points import point_history
from sarmitsuba.simulation.planning.sampling.density_plan import azimuth_cell
from sarmitsuba.simulation.planning.sampling.launch_window import LaunchWindow

# ghosts of a point are reported above this part of its own power
_LEAST = 1e-4
# number of points examined for ghosts, brightest first; and the ambiguity orders
_MOST_POINTS, _ORDERS = 16, 3
# size of one step of the search for a ghost's peak; bounds memory and time
_MOST_TERMS = 4_000_000
# resolution cells searched for a ghost's peak about its predicted position, azimuth and range
_SEARCH = (6.0, 3.0)
# azimuth cells outside the image within which the main lobe of a ghost, with any window, reaches into it
_MAIN_LOBE = 2.0


@dataclass(frozen=True)
class _Ghost:
    """Azimuth ambiguity (ghost) of a point in the image.

    Parameters
    ----------
    power : m^2, estimated, at its peak
    apart : m, along the track from the point's position in the image
    """

    power: float
    apart: float


def check_folding(scene: Scene, windows: tuple[LaunchWindow, ...] = ()) -> list[str]:
    """Warn of azimuth ambiguities of lit points and surfaces in the image; returns the warnings' texts.

    Parameters
    ----------
    scene : with the points that the image can show
    windows : launch windows of the rays

    Notes
    -----
    For straight tracks. The ambiguity level of a uniform scene is reported when the radar is built.
    """
    radar, track = scene.radar, scene.radar.track
    if track.n_pulses < 3 or radar.all_round or not track.is_straight or radar.receiver is not None:
        return []
    speed = float(np.linalg.norm(track.velocity[track.center_index]))
    wavelength = radar.waveform.wavelength
    beam = beam_bandwidth(radar.antenna, speed, wavelength, radar.half_aperture)
    moving = scene.moves
    if track.prf >= beam and not moving:
        return []
    reach = float(np.linalg.norm(_middle(scene) - track.center_position))
    apart = wavelength * reach * track.prf / (2.0 * speed)
    notes = [*_warn_of_points(scene, speed), *_warn_of_windows(scene, windows, apart, beam)]
    for note in notes:
        warnings.warn(note, SarmitsubaWarning, stacklevel=4)
    return notes


def _warn_of_points(scene: Scene, speed: float) -> list[str]:
    """Warnings about the brightest ghost of each bright point in the image."""
    radar, found = scene.radar, []
    bright = sorted(scene.points, key=lambda point: -point.rcs)[:_MOST_POINTS]
    for point in bright:
        history = point_history(radar, point, slice(None))
        ghosts = [
            ghost
            for order in range(-_ORDERS, _ORDERS + 1)
            if order
            for ghost in _ghost(scene, point, history, order, speed)
        ]
        strongest = max(ghosts, key=lambda ghost: ghost.power, default=None)
        if strongest is not None and strongest.power > _LEAST * point.rcs:
            found.append((strongest, point))
    if not found:
        return []
    ghost, point = max(found, key=lambda pair: pair[0].power)
    place = ", ".join(f"{v:.6g}" for v in point.position + scene.offset)
    more = f", and {len(found) - 1} more points leave weaker ones" if len(found) > 1 else ""
    level = float(db_from_power(np.array(ghost.power)))
    return [
        f'{scene.name}: point_scatterer "{point.name}" at ({place}) m leaves a ghost of about {level:.1f} dBsm in the '
        f"image, {ghost.apart:+.4g} m along the track from its own place{more}: prf = {radar.track.prf:.6g} Hz folds "
        "it in; raise prf, or move the image"
    ]


def _ghost(
    scene: Scene, point: PointTarget, history: tuple[F64, F64], order: int, speed: float
) -> list[_Ghost]:
    """Ghost of one ambiguity order whose main lobe lies at least partly in the image.

    ``history`` is the point's slant range (m) and its rate.
    """
    radar, track, image = scene.radar, scene.radar.track, scene.image
    distance, rate = history
    step = order * radar.waveform.wavelength * track.prf / (2.0 * speed)
    sine, boresight = -rate / speed, radar.pointing.boresight @ track.along
    own = np.isfinite(radar.half_aperture)
    pulse = int(np.argmin(np.abs(sine + step - boresight))) if own else track.center_index
    at = float(sine[pulse]) + step
    if abs(at) >= 1.0 or (own and abs(at - boresight[pulse]) > 0.5 * radar.half_aperture):
        return []
    antenna = track.position[pulse]
    across2 = float(distance[pulse]) ** 2 * (1.0 - at**2) - (antenna[2] - image.height) ** 2
    if across2 <= 0.0:
        return []
    place = antenna + float(distance[pulse]) * at * track.along + np.sqrt(across2) * radar.across
    place[2] = image.height
    lobe = np.array([_MAIN_LOBE * azimuth_cell(scene), 0.0])
    if (_measure_distance(scene, place) > lobe).any():
        return []
    return [_Ghost(point.rcs * _level(scene, point, distance, place), float(distance[pulse] * step))]


def _level(scene: Scene, point: PointTarget, distance: F64, place: F64) -> float:
    r"""Largest power of a point's echoes when focused near another position, relative to its own peak.

    .. math:: \left| \frac{\sum_t g_t \,\mathrm{sinc}((r_t - R_t) / \delta_r) e^{j 4 \pi (r_t - R_t) / \lambda}}
              {\sum_t g_t} \right|^2

    over the pulses of that position's aperture, r_t its slant range and R_t the point's; in the image only.
    """
    radar, track = scene.radar, scene.radar.track
    wavelength, cell = radar.waveform.wavelength, radar.waveform.range_cell
    position = point.position_at(track.time)
    gain = direction_gain(radar, slice(None), unit_rows(position - track.position))
    line = unit_rows(place - track.position)
    mask = np.abs((line - radar.pointing.boresight) @ track.along) <= radar.half_aperture
    own = float((direction_gain(radar, slice(None), line) * mask).sum())
    if own == 0.0 or not mask.any():
        return 0.0
    turn = float(np.ptp(line[mask] @ track.along))
    azimuth = wavelength / (2.0 * max(turn, 1e-9))
    ground = cell / max(float(np.sqrt(1.0 - line[track.center_index, 2] ** 2)), 0.05)
    shape = (int(4 * _SEARCH[0]) + 1, int(4 * _SEARCH[1]) + 1)
    steps = (np.linspace(-s, s, n) for s, n in zip(_SEARCH, shape, strict=True))
    along, across = np.meshgrid(*steps, indexing="ij")
    places = (
        place + azimuth * along.reshape(-1, 1) * track.along + ground * across.reshape(-1, 1) * radar.across
    )
    places = places[(_measure_distance(scene, places) <= 0.0).all(axis=1)]
    best, batch = 0.0, max(1, _MOST_TERMS // track.n_pulses)
    for start in range(0, len(places), batch):
        r = np.linalg.norm(places[start : start + batch, None] - track.position[mask], axis=2)
        off = r - distance[mask]
        terms = gain[mask] * np.sinc(off / cell) * np.exp(4j * np.pi / wavelength * off)
        best = max(best, float((np.abs(terms.sum(axis=1)) ** 2).max()))
    return best / own**2


def _warn_of_windows(scene: Scene, windows: tuple[LaunchWindow, ...], apart: float, beam: float) -> list[str]:
    """Warnings about surfaces lit outside the image because of moving shapes, which fold into it."""
    track, image = scene.radar.track, scene.image
    half = 0.5 * image.extent_azimuth
    if not windows or apart < 2.0 * half or track.prf >= beam:
        return []
    farthest = max(window.reach for window in windows)
    if not scene.geometry.moves or farthest + half <= apart:
        return []
    names = [
        name
        for name, motion in zip(scene.geometry.mesh_names, scene.geometry.mesh_motion, strict=True)
        if not motion.still
    ]
    needed = track.prf * (farthest + half) / apart
    return [
        f'{scene.name}: to show motion ("{names[0]}"), surfaces are lit up to {farthest - half:.4g} m beyond the '
        f"image, and those farther than {apart - 2.0 * half:.4g} m fold into it at their full level at prf = "
        f"{track.prf:.6g} Hz; raise prf to {min(needed, beam):.4g} Hz, or enlarge the image"
    ]


def _measure_distance(scene: Scene, places: F64) -> F64:
    """Distances (..., 2), m, of points (..., 3) of the image plane beyond the image's edges along and across track."""
    axes = np.stack([scene.radar.track.along, scene.radar.across], axis=1)
    half = 0.5 * np.array([scene.image.extent_azimuth, scene.image.extent_range])
    return np.asarray(np.abs((places - _middle(scene)) @ axes) - half)


def _middle(scene: Scene) -> F64:
    return np.array([scene.image.center_x, scene.image.center_y, scene.image.height])
