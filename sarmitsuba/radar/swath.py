"""Swath of the radar: the image's box, its slant ranges and Doppler bandwidth, the receive window.

The footprint of the beam is its half-power outline at a pulse, or over the track. Coverage of the scene by image and
beam, and ambiguities, follow.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sarmitsuba.core.arrays import F64, unit_rows
from sarmitsuba.core.constants import SPEED_OF_LIGHT
from sarmitsuba.core.errors import RadarError
from sarmitsuba.radar.antenna import Antenna
from sarmitsuba.radar.pattern import PATTERNS, SINC_HALF_POWER
from sarmitsuba.radar.radar import Radar, ReceiveWindow

# range cells of margin on both sides of the window, for side lobes and interpolation
_MARGIN_CELLS = 16


@dataclass(frozen=True, eq=False)
class Box:
    """Box with vertical sides aligned with the flight direction.

    Parameters
    ----------
    origin : (3,) float64, m, scene frame; the aim point
    axes : (3, 3) float64; rows are the unit vectors along, across (to the look side) and up
    low, high : (3,) float64, m, corners in these axes from ``origin``
    """

    origin: F64
    axes: F64
    low: F64
    high: F64

    def local(self, points: F64) -> F64:
        """Scene-frame points (n, 3) in the box's axes."""
        return np.asarray((points - self.origin) @ self.axes.T)

    def samples(self) -> F64:
        """Corners and midpoints of the edges, (18, 3), in the box's axes, m."""
        mid = 0.5 * (self.low + self.high)
        grid = np.meshgrid(
            *(np.array([self.low[i], mid[i], self.high[i]]) for i in range(2)),
            np.array([self.low[2], self.high[2]]),
            indexing="ij",
        )
        return np.stack([g.ravel() for g in grid], axis=1)

    def slant_ranges(self, position: F64) -> tuple[F64, F64]:
        """Shortest and longest distance of the box from (n, 3) scene-frame positions, (n,) float64, m."""
        q = self.local(position)
        nearest = np.clip(q, self.low, self.high)
        farthest = np.where(np.abs(q - self.low) > np.abs(q - self.high), self.low, self.high)
        return np.linalg.norm(q - nearest, axis=1), np.linalg.norm(q - farthest, axis=1)

    def overlap(self, other_low: F64, other_high: F64) -> tuple[F64, F64] | None:
        """Corners of the intersection with another box in the same axes; None when they do not overlap."""
        low, high = np.maximum(self.low, other_low), np.minimum(self.high, other_high)
        return None if (low > high).any() else (low, high)


def doppler_bandwidth(
    position: F64, velocity: F64, box: Box, wavelength: float, *, instantaneous: bool = False
) -> float:
    r"""Doppler bandwidth of a box seen from several positions, Hz.

    .. math:: f_D = 2 v \cdot u / \lambda

    Parameters
    ----------
    position, velocity : (n, 3) float64, m and m/s, scene frame
    box : of the scene
    wavelength : m
    instantaneous : largest spread at one position in place of the spread over all positions
    """
    points = box.samples() @ box.axes + box.origin
    line = points[None, :, :] - position[:, None, :]
    line = unit_rows(line)
    frequency = 2.0 / wavelength * np.einsum("npc,nc->np", line, velocity)
    if instantaneous:
        return float(np.ptp(frequency, axis=1).max())
    return float(np.ptp(frequency))


def beam_bandwidth(antenna: Antenna, speed: float, wavelength: float, half_aperture: float = np.inf) -> float:
    r"""Pulse rate (Hz) above which the beam, to its first nulls, is not aliased into the processed band.

    .. math:: f = \frac{2 v}{\lambda} (s_0 + \min(s_0, s_a))

    s_0 the sine to the first null and s_a ``half_aperture``; infinite when isotropic. Without ``half_aperture`` it is
    the Doppler spread of the whole beam at one instant.
    """
    if not antenna.directive:
        return np.inf
    null = antenna.nulls[0]
    return 2.0 * speed / wavelength * (null + min(null, half_aperture))


def receive_window(
    positions: Sequence[F64],
    center: F64,
    box: Box,
    range_cell: float,
    sample_spacing: float,
    near_range: float = 0.0,
    far_range: float = 0.0,
) -> ReceiveWindow:
    """Receive window that contains the echoes of a box from every pulse.

    The start is the same for all pulses unless the range of the aim point migrates by more than a quarter of
    the swath; then it follows that range in whole samples.

    Parameters
    ----------
    positions : (n_pulses, 3) float64, m, scene frame, of every antenna: of one, or of transmitter and receiver
    center : (3,) mid-aperture position
    box : to be covered; its height is added at both ends for multiple bounces
    range_cell, sample_spacing : m
    near_range, far_range : given limits at mid-aperture, m; 0 = automatic
    """
    ranges = [(*box.slant_ranges(p), np.linalg.norm(p - box.origin, axis=1)) for p in positions]
    near, far, to_aim = ranges[0] if len(ranges) == 1 else np.mean(ranges, axis=0)
    follow = np.zeros_like(to_aim)
    if np.ptp(to_aim) > 0.25 * float((far - near).max()):
        mid = float(np.linalg.norm(center - box.origin))
        follow = np.round((to_aim - mid) / sample_spacing) * sample_spacing
    margin = max(_MARGIN_CELLS * range_cell, float(box.high[2] - box.low[2]))
    start = near_range or float((near - follow).min()) - margin
    stop = far_range or float((far - follow).max()) + margin
    start = max(start, sample_spacing - float(follow.min()))
    n = int(np.ceil((stop - start) / sample_spacing)) + 1
    if not far_range:
        n = fast_length(max(n, 2))
    return ReceiveWindow(start + follow, sample_spacing, n)


def fast_length(n: int) -> int:
    """Smallest whole number from ``n`` on without prime factors above 11, for which SciPy's transforms are fast.

    That of ``scipy.fft.next_fast_len``, whose import takes longer than the loading of a small scene.
    """
    while True:
        rest = n
        for prime in (2, 3, 5, 7, 11):
            while rest % prime == 0:
                rest //= prime
        if rest == 1:
            return n
        n += 1


_MOST_AMBIGUITIES = 10_000.0  # most orders of ambiguities that are summed
_SMALL_SHARE = 0.005  # smallest energy share of ghosts that is reported


def check_coverage(radar: Radar, scene: Box, box: Box, where: str, film_where: str) -> Box:
    """Raise a RadarError when image and geometry, or beam and geometry, do not overlap.

    Parameters
    ----------
    radar : with track, antenna and pointing
    scene, box : bounds of the geometry and of the image, in the same axes
    where, film_where : start of an error about the sensor, about the film

    Returns
    -------
    the part of the scene that the image holds
    """
    drop = float(radar.track.center_position[2] - box.origin[2])
    reach = max(float(-scene.local(radar.track.center_position[None])[0, 1]), 1e-9)
    layover = max(0.0, float(scene.high[2])) * max(drop, 0.0) / reach
    shared = box.overlap(scene.low - np.array([0.0, layover, 0.0]), scene.high)
    if shared is None:
        raise RadarError(
            f"{film_where}: the image covers {_span(box, 0)} along and {_span(box, 1)} across the "
            f"track from the aim point, the scene {_span(scene, 0)} and {_span(scene, 1)}: they do not overlap; "
            "move the aim point or image_center_x, image_center_y"
        )
    seen = replace(box, low=shared[0], high=shared[1])
    if not radar.antenna.directive:
        return seen
    points = seen.samples() @ seen.axes + seen.origin
    pick = np.unique(np.linspace(0, radar.track.n_pulses - 1, 65).astype(int))
    line = points[None] - radar.track.position[pick][:, None]
    line = unit_rows(line)
    ahead = np.einsum("npc,nc->np", line, radar.pointing.boresight[pick]) > 0.0
    inside = ahead.any(axis=1)
    worst = []
    axes = (radar.pointing.azimuth_axis, radar.pointing.elevation_axis)
    for axis, null in zip(axes, radar.antenna.nulls, strict=True):
        sine = np.einsum("npc,nc->np", line, axis[pick])
        inside &= (sine.min(axis=1) < null) & (sine.max(axis=1) > -null)
        gap = np.maximum(np.maximum(sine.min(axis=1), -sine.max(axis=1)), 0.0)
        worst.append(float(np.degrees(np.arcsin(np.clip(gap.min(), 0.0, 1.0)))))
    if not inside.any():
        raise RadarError(
            f"{where}: the scene is outside the beam, {worst[0]:.3g} deg off in azimuth and "
            f"{worst[1]:.3g} deg in elevation (half-power widths "
            f"{np.degrees(radar.antenna.azimuth_beamwidth):.3g} deg and "
            f"{np.degrees(radar.antenna.elevation_beamwidth):.3g} deg); aim at it or widen the beam"
        )
    return seen


def ambiguities(radar: Radar, seen: Box, image: Box, where: str, *, derived: bool) -> list[str]:
    """Warnings about Doppler and range ambiguity, one line each.

    Parameters
    ----------
    radar : complete
    seen : part of the scene in the image, which can appear as a ghost anywhere in the image
    image : the image's box, in the same axes
    where : start of every line
    derived : prf computed from the number of pulses and the resolution
    """
    track = radar.track
    if track.n_pulses < 2:
        return []
    notes = []
    prf = track.prf
    pick = np.unique(np.linspace(0, track.n_pulses - 1, 33).astype(int))
    position, velocity = track.position[pick], track.velocity[pick]
    lam = radar.waveform.wavelength
    speed = float(np.linalg.norm(velocity, axis=1).max())
    own = np.isfinite(radar.half_aperture)  # the track is longer than any pixel's aperture
    at_once = own or radar.mode_law.instantaneous_doppler or not track.is_straight
    reach = _reach(seen, image)
    beam = beam_bandwidth(radar.antenna, speed, lam, radar.half_aperture)
    spread = doppler_bandwidth(position, velocity, reach, lam, instantaneous=True)
    width = float(reach.high[0] - reach.low[0])
    apart = prf / max(spread, 1e-30) * width
    needed = doppler_bandwidth(position, velocity, seen, lam, instantaneous=at_once)
    if own:
        used = 0.0 if radar.mode_law.instantaneous_doppler else 4.0 * speed / lam * radar.half_turn
        share = _share_by_beam(radar, prf * lam / (2.0 * speed), width / max(apart, 1e-30))
        # the beam attenuates the ghosts: where none are left, only the pixels' own band has to be sampled
        needed = needed + used if share >= _SMALL_SHARE else used
    else:
        share = _share_by_place(seen, image, apart)
    if share >= _SMALL_SHARE:
        needed = max(needed, spread)
    needed = min(needed, beam)
    if prf < needed * (1.0 - 1e-9):
        ghosts = (
            f": azimuth ghosts {apart:.4g} m apart will hold about {100.0 * share:.0f} % of the image's energy"
            if share >= _SMALL_SHARE
            else ""
        )
        remedy = (
            "raise n_pulses or coarsen azimuth_resolution" if derived else f"raise prf to {needed:.4g} Hz"
        )
        notes.append(
            f"{where}: prf = {prf:.6g} Hz is below the Doppler bandwidth {needed:.6g} Hz of the image{ghosts}; "
            f"{remedy}, or narrow the beam"
        )
    length = radar.window.extent + SPEED_OF_LIGHT * radar.waveform.pulse_width / 2.0
    if length > SPEED_OF_LIGHT / (2.0 * prf):
        notes.append(
            f"{where}: the echoes of one pulse last {length:.6g} m in range, longer than the "
            f"unambiguous range {SPEED_OF_LIGHT / (2.0 * prf):.6g} m at prf = {prf:.6g} Hz; lower prf, speed "
            "or pulse_width"
        )
    return notes


def _reach(seen: Box, image: Box) -> Box:
    """Box whose azimuth length is the largest distance between a pixel and its possible ghosts."""
    ends = ((seen.low[0], image.high[0]), (image.low[0], seen.high[0]))
    low, high = max(ends, key=lambda pair: float(pair[1] - pair[0]))
    return replace(seen, low=np.array([low, *seen.low[1:]]), high=np.array([max(low, high), *seen.high[1:]]))


def _share_by_place(seen: Box, image: Box, apart: float) -> float:
    """Energy share of the ghosts in an image of targets distributed uniformly over ``seen``.

    With one aperture common to all pixels a target repeats with its full energy at every multiple of ``apart`` (m)
    within the image.
    """
    place = np.linspace(float(seen.low[0]), float(seen.high[0]), 101)
    before = np.floor((place - image.low[0]) / apart)
    after = np.floor((image.high[0] - place) / apart)
    ghosts = float((np.maximum(before, 0.0) + np.maximum(after, 0.0)).mean())
    return ghosts / (1.0 + ghosts)


def _share_by_beam(radar: Radar, step: float, farthest: float) -> float:
    r"""Energy share of azimuth ambiguities with a beam that passes over the pixels one after the other.

    .. math:: A = \sum_{0 < |k| \le n} \int_{-s_a}^{s_a} G^2(s + k \Delta) ds / \int_{-s_a}^{s_a} G^2(s) ds

    with the two-way power G^2 of the pattern, half aperture s_a and, at a pulse repetition frequency f_p,
    Delta = lambda f_p / (2 v); the share is A / (1 + A).

    Parameters
    ----------
    radar : gives pattern and half aperture
    step : Delta
    farthest : length of the image and its ghosts in steps of Delta
    """
    sine = np.linspace(-radar.half_aperture, radar.half_aperture, 257)
    n = np.floor(min(farthest, _MOST_AMBIGUITIES))
    order = np.arange(-n, n + 1.0)[:, None]
    shifted = np.clip(sine + order * step, -1.0, 1.0)
    power = np.asarray(radar.antenna.two_way_amplitude(shifted, np.zeros_like(shifted))) ** 2
    total = power.sum(axis=1)
    wrong = float(total[order[:, 0] != 0.0].sum())
    whole = wrong + float(total[order[:, 0] == 0.0].sum())
    return wrong / whole if whole > 0.0 else 0.0  # a beam without gain there gives no ghosts


def _span(box: Box, axis: int) -> str:
    return f"{box.low[axis]:.6g} to {box.high[axis]:.6g} m"


Mask = NDArray[np.bool_]

# pulses that sample the track
_PULSES = 129
# bisection steps, after which the contour is known to float64
_HALVINGS = 55


@dataclass(frozen=True, eq=False)
class Lit:
    """Illumination of points by the half-power beam over the track.

    Parameters
    ----------
    ever : (...,) bool; at least one pulse illuminates the point
    whole : (...,) bool; the point has its whole aperture: every pulse illuminates it, or, where the beam passes over
        the pixels one after the other, the track contains the point's whole aperture
    """

    ever: Mask
    whole: Mask


def outline(radar: Radar, pulse: int, height: float = 0.0, n: int = 97) -> F64:
    r"""One-distance half-power contour of the beam on a horizontal plane, a closed line (n, 3) m.

    The contour is :math:`G(\sin\alpha, \sin\epsilon) = 1/2`, G the one-way power gain over the components of direction
    along the antenna's azimuth and elevation axes, relative to its peak.

    Parameters
    ----------
    radar : with a beam
    pulse : its index
    height : of the plane, m, scene frame
    n : points of the line, the last is the first again; those that look above the plane are NaN

    Raises
    ------
    RadarError
        The antenna is isotropic and has no contour.

    Notes
    -----
    Ignores the Earth's curvature, and the elevation beam's height over terrain.
    """
    _has_beam(radar)
    p, antenna = radar.pointing, radar.antenna
    angle = np.linspace(0.0, 2.0 * np.pi, n)
    across = np.stack([np.cos(angle) / antenna.per_width[0], np.sin(angle) / antenna.per_width[1]])
    low, high = (
        np.zeros(n),
        np.full(n, PATTERNS[antenna.pattern].find_null() or 1.0 / SINC_HALF_POWER),
    )  # searched to the first null, where the pattern has one
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        inside = np.asarray(antenna.two_way_amplitude(*(middle * across))) > 0.5
        low, high = np.where(inside, middle, low), np.where(inside, high, middle)
    azimuth, elevation = low * across
    ahead = np.sqrt(np.maximum(1.0 - azimuth**2 - elevation**2, 0.0))
    look = np.stack([azimuth, elevation, ahead], axis=1) @ np.stack(
        [p.azimuth_axis[pulse], p.elevation_axis[pulse], p.boresight[pulse]]
    )
    antenna_at = radar.track.position[pulse]
    with np.errstate(divide="ignore", invalid="ignore"):
        distance = (height - antenna_at[2]) / look[:, 2]
    distance = np.where((distance > 0.0) & np.isfinite(distance), distance, np.nan)
    return np.asarray(antenna_at + distance[:, None] * look)


def illuminate_points(radar: Radar, points: ArrayLike) -> Lit:
    """Illumination of points (..., 3), m, scene frame, by the beam over the track.

    Raises
    ------
    RadarError
        The antenna is isotropic and illuminates everything.

    Notes
    -----
    Samples 129 pulses, so that the ends of an aperture are known to a 128th of the track. Ignores shadows.
    """
    _has_beam(radar)
    place = np.asarray(points, dtype=np.float64)
    track, pointing, antenna = radar.track, radar.pointing, radar.antenna
    pick = np.unique(np.linspace(0, track.n_pulses - 1, _PULSES).astype(int))
    line = place[..., None, :] - track.position[pick]
    line = unit_rows(line)
    azimuth, elevation, ahead = (
        np.sum(line * axis[pick], axis=-1)
        for axis in (pointing.azimuth_axis, pointing.elevation_axis, pointing.boresight)
    )
    inside = (np.asarray(antenna.two_way_amplitude(azimuth, elevation)) >= 0.5) & (ahead > 0.0)
    ever = inside.any(axis=-1)
    if not radar.mode_law.own_apertures:
        return Lit(ever, inside.all(axis=-1))
    # the point's aperture: processed sines off the boresight, at most the half-power width
    half = min(radar.half_aperture, float(np.sin(0.5 * antenna.azimuth_beamwidth)))
    forward = track.velocity[pick] / np.linalg.norm(track.velocity[pick], axis=1)[:, None]
    offset = np.sum(line * forward, axis=-1) - np.sum(pointing.boresight[pick] * forward, axis=1)
    passed = (offset.max(axis=-1) >= half) & (offset.min(axis=-1) <= -half)
    return Lit(ever, ever & passed)


def _has_beam(radar: Radar) -> None:
    if not radar.antenna.directive:
        raise RadarError(
            "footprint: pattern = isotropic illuminates everything and has no outline; use gaussian or rectangular"
        )
