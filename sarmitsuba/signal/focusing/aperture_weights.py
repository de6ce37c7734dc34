"""Synthetic aperture of one point: antenna weights, and area and shape of the impulse response.

Beams only a few azimuth cells wide have a gain that varies within a cell, and a noise-equivalent cell that allows for
it.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from sarmitsuba.core.arrays import F64, I64, unit_rows
from sarmitsuba.core.constants import SPEED_OF_LIGHT
from sarmitsuba.core.errors import DataError
from sarmitsuba.radar.antenna import Pointing
from sarmitsuba.radar.radar import Radar
from sarmitsuba.signal.focusing.windows import WINDOWS, Window, parse_window
from sarmitsuba.signal.image import ImageGrid

# azimuth cells from the beam's centre to its first null above which the gain is constant over a cell: 0.003 dB
WIDE_BEAM = 16.0
# samples of the aperture, samples of the ground per azimuth cell, and extent of the clutter in nulls
_PULSES, _PER_CELL, _NULLS = 128, 4, 2.0


def beam_over_cell(radar: Radar, point: F64, weights: F64) -> float:
    r"""Noise-equivalent area of the impulse response, relative to that with the pixel's gain for all clutter.

    A pixel at p gives the echo of pulse t the weight :math:`W_t / g_t(p)` besides its phase. Clutter at q has its own
    gain g(q), so that

    .. math:: \frac{A}{A_0} = \frac{\int |\sum_t W_t \frac{g_t(q)}{g_t(p)} e^{-j k (R_t(q) - R_t(p))}|^2 dx}
              {2 \pi \sum_t W_t^2 / |\Delta \kappa_t|}, \quad \kappa = k \, \partial R_t / \partial x

    over the places q at the distance x from p along the circle of equal range. Exactly 1 for an isotropic antenna, and
    for a beam wider than ``WIDE_BEAM``.

    Parameters
    ----------
    radar : gives track, beam and waveform
    point : (3,) m, scene frame
    weights : (n_pulses,) W, of the echoes of a scatterer at that point

    Notes
    -----
    Ignores range walk of the clutter within its few cells, the pattern's change in elevation over a range cell, and the
    separate beam of a bistatic receiver.
    """
    if not radar.antenna.directive or not (weights > 0.0).any():
        return 1.0
    place = np.asarray(point, dtype=np.float64)
    lit = np.flatnonzero(weights > 1e-9 * weights.max())
    index = np.arange(weights.size)
    at = np.linspace(lit[0], lit[-1], min(_PULSES, int(lit[-1] - lit[0]) + 1))
    share = np.interp(at, index, weights)

    def between(rows: F64) -> F64:
        return np.stack([np.interp(at, index, column) for column in rows.T], axis=1)

    antennas = [between(track.position) for track in radar.tracks]
    wavenumber = 4.0 * np.pi / radar.waveform.wavelength
    middle = share @ antennas[0] / share.sum()
    out = place - middle
    reach = float(np.hypot(out[0], out[1]))
    if reach == 0.0:
        return 1.0
    sideways = np.array([-out[1], out[0], 0.0]) / reach
    wavenumbers = wavenumber * np.mean(
        [(place - a) @ sideways / np.linalg.norm(place - a, axis=1) for a in antennas], axis=0
    )
    if at.size < 2:
        return 1.0
    step = np.abs(np.gradient(wavenumbers))
    cell = 2.0 * np.pi / max(float(np.ptp(wavenumbers)), 1e-300)
    aside = radar.pointing.azimuth_axis @ sideways
    across = float(np.abs(np.interp(at[at.size // 2], index, aside)))
    null = radar.antenna.nulls[0] * float(np.linalg.norm(out)) / max(across, 0.1)
    if null > WIDE_BEAM * cell or not step.all():
        return 1.0

    pointing = radar.pointing
    azimuth, elevation, boresight = map(
        between, (pointing.azimuth_axis, pointing.elevation_axis, pointing.boresight)
    )

    def seen(where: F64) -> tuple[F64, F64]:
        """Slant ranges and two-way amplitudes of places (..., 1, 3)."""
        legs = [where - antenna for antenna in antennas]
        distances = [np.linalg.norm(leg, axis=-1) for leg in legs]
        sines = [np.sum(legs[0] * axis, axis=-1) / distances[0] for axis in (azimuth, elevation, boresight)]
        gain = np.asarray(radar.antenna.two_way_amplitude(sines[0], sines[1]))
        return 0.5 * (distances[0] + distances[-1]), np.where(sines[2] > 0.0, gain, 0.0)

    range_here, gain_here = seen(place)
    # up to the pulses' ambiguities
    farthest = min(_NULLS * null, np.pi / float(step.max()))
    # centres of whole steps: a shortened last step would vary abruptly from column to column of an image
    n = int(np.ceil(2.0 * farthest * _PER_CELL / cell))
    x = ((np.arange(n) + 0.5) * (2.0 / n) - 1.0) * farthest
    cosine, sine = np.cos(x / reach), np.sin(x / reach)
    turned = [out[0] * cosine - out[1] * sine, out[0] * sine + out[1] * cosine, np.full_like(x, out[2])]
    ranges, gains = seen((middle + np.stack(turned, axis=1))[:, None])
    held = np.where(gain_here > 0.0, share / np.maximum(gain_here, 1e-300), 0.0)
    response = (gains * np.exp(-1j * wavenumber * (ranges - range_here))) @ held
    area = float(np.sum(np.abs(response) ** 2)) * (2.0 * farthest / n)
    alike = 2.0 * np.pi * float(np.sum(share**2 / step))
    return area / alike


DARK = 0.01
"""Summed weight w g^2, over the image's largest, above which a place counts as illuminated: a tenth in amplitude."""
# rounding of a component of a float32 unit vector along a direction, rms
_SINE_ROUNDING = 3.5e-8
# summed weight over the largest below which a place counts as not illuminated: its pixel is zero
_UNLIT = 1e-6
# largest difference of the two beams' amplitudes, relative to the transmitter's peak
_BEAMS_APART = 0.1


def direction_gain(radar: Radar, pulse: int | slice, direction: F64, pointing: Pointing | None = None) -> F64:
    """Relative two-way amplitude of the antenna towards unit vectors, zero behind the aperture.

    Parameters
    ----------
    radar : gives the pattern and its pointing
    pulse : a pulse index, or a slice whose length matches the last but one axis of ``direction``
    direction : (..., 3) float64, scene frame, from the antenna
    pointing : of an antenna other than the transmitter

    Returns
    -------
    (...) float64, 1 at boresight
    """
    if not radar.antenna.directive:
        return np.ones(direction.shape[:-1])
    p = pointing or radar.pointing
    gain = radar.antenna.two_way_amplitude(
        np.sum(direction * p.azimuth_axis[pulse], axis=-1),
        np.sum(direction * p.elevation_axis[pulse], axis=-1),
    )
    return np.asarray(np.where(np.sum(direction * p.boresight[pulse], axis=-1) > 0.0, gain, 0.0))


def antennas_gain(radar: Radar, pulse: int | slice, directions: Sequence[F64]) -> F64:
    """Geometric mean of :func:`direction_gain` of one or two antennas, for the directions (..., 3) from each."""
    gains = [
        direction_gain(radar, pulse, direction, pointing)
        for direction, pointing in zip(directions, radar.pointings, strict=True)
    ]
    return gains[0] if len(gains) == 1 else np.asarray(np.sqrt(gains[0] * gains[1]))


def look_directions(radar: Radar, point: ArrayLike, pulses: slice = slice(None)) -> F64:
    """Unit vectors from antenna positions to points (..., 3), giving (..., n_pulses, 3) float64."""
    line = np.asarray(point, dtype=np.float64)[..., None, :] - radar.track.position[pulses]
    return unit_rows(line)


def pulse_ranges(radar: Radar, point: ArrayLike, pulses: slice | I64 = slice(None)) -> F64:
    """Slant range of points (..., 3) in every pulse, (..., n_pulses) m: half the path there and to the receiver."""
    place = np.asarray(point, dtype=np.float64)[..., None, :]
    distance = np.linalg.norm(place - radar.track.position[pulses], axis=-1)
    if radar.receiver is not None:
        distance = 0.5 * (distance + np.linalg.norm(place - radar.receiver.position[pulses], axis=-1))
    return np.asarray(distance)


def range_gradients(radar: Radar, point: ArrayLike, pulses: slice = slice(None)) -> F64:
    """Gradient of the slant range of points (..., 3), (..., n_pulses, 3): line of sight, bistatic the mean of both."""
    look = look_directions(radar, point, pulses)
    if radar.receiver is None:
        return look
    return 0.5 * (look + look_directions(replace(radar, track=radar.receiver), point, pulses))


def band_weights(offset: F64, step: F64 | float, half_aperture: float, window: Window) -> F64:
    r"""Azimuth weight of samples of the Doppler band that is a pixel's aperture.

    .. math:: w = \mathrm{window}(o / 2 s_a) \min(1, \max(0, (s_a - |o|) / \Delta + 1/2))

    A sample at the band's end counts by its part inside the band, so that the sum is continuous from pixel to pixel.

    Parameters
    ----------
    offset : sine along the flight less the band's centre, any shape
    step : distance of neighbouring samples' offsets
    half_aperture : half of the band, see :class:`sarmitsuba.radar.radar.Radar`
    window : over the band
    """
    share = np.clip((half_aperture - np.abs(offset)) / step + 0.5, 0.0, 1.0)
    return np.asarray(window(np.clip(offset / (2.0 * half_aperture), -0.5, 0.5)) * share)


def bistatic_refusal(radar: Radar) -> str:
    """Reason why bistatic data cannot be backprojected; empty when they can, or are monostatic."""
    if radar.receiver is None or (not radar.antenna.directive and np.isinf(radar.half_aperture)):
        return ""
    if radar.receives_itself:
        return ""
    if radar.receiver_pointing is None:
        return "the data are bistatic and give no pattern of the receiver; give an isotropic antenna"
    other = replace(
        radar,
        track=radar.receiver,
        pointing=radar.receiver_pointing,
        receiver=None,
        receiver_pointing=None,
        delay=None,
    )
    sent, received = (
        direction_gain(one, slice(None), look_directions(one, radar.aim_point)) for one in (radar, other)
    )
    apart = float(np.abs(received - sent).max() / max(float(sent.max()), 1e-300))
    if apart <= _BEAMS_APART:
        return ""
    return (
        f"the beams of transmitter and receiver differ by {100.0 * apart:.0f} % at the aim point, and pulses are "
        "weighed by the transmitter's; bring the receiver nearer or give an isotropic antenna"
    )


@lru_cache(maxsize=8)
def flight(radar: Radar) -> tuple[F64, F64, F64]:
    """Per pulse: unit vector of flight (n_pulses, 3), boresight's sine along it, and distance to the next pulse, m.

    Kept for the radars asked for last; not to be written to.
    """
    speed = np.linalg.norm(radar.track.velocity, axis=1)
    forward = radar.track.velocity / np.maximum(speed, 1e-300)[:, None]
    gap = speed * (np.gradient(radar.track.time) if speed.size > 1 else np.ones(1))
    found = forward, np.einsum("ij,ij->i", forward, radar.pointing.boresight), gap
    for part in found:
        part.setflags(write=False)
    return found


@lru_cache(maxsize=8)
def beam_turn(radar: Radar) -> F64:
    """Change of the boresight's sine along the flight from one pulse to the next, (n_pulses,); 0 in stripmap."""
    _, center, _ = flight(radar)
    return np.gradient(center) if center.size > 1 else np.zeros(1)


def aperture_weights(radar: Radar, point: ArrayLike, azimuth_window: str | Window) -> F64:
    """Azimuth weight w of every pulse at points (..., 3), (..., n_pulses): over pulse index or the pixel's band."""
    window, place = parse_window(azimuth_window), np.asarray(point, dtype=np.float64)
    if np.isinf(radar.half_aperture):
        return _whole_aperture(radar.track.n_pulses, window, WINDOWS[window.name].function).copy()
    weights = np.zeros((*place.shape[:-1], radar.track.n_pulses))
    pulses = _serving(radar, place)
    weights[..., pulses] = own_aperture_weights(radar, place, pulses, window)
    return weights


def _serving(radar: Radar, place: F64) -> slice:
    """The least consecutive pulses that hold all own apertures of places (..., 3)."""
    forward, center, gap = flight(radar)
    inside = np.zeros(radar.track.n_pulses, dtype=bool)
    for x, y, z in place.reshape(-1, 3):
        line = [p - a for p, a in zip((x, y, z), radar.track.position.T, strict=True)]
        distance = np.sqrt(line[0] ** 2 + line[1] ** 2 + line[2] ** 2)
        sine = (line[0] * forward[:, 0] + line[1] * forward[:, 1] + line[2] * forward[:, 2]) / distance
        # the pulses beside the band's ends count in part
        spare = np.abs(gap) / distance + np.abs(beam_turn(radar))
        inside |= np.abs(sine - center) < radar.half_aperture + spare
    held = np.flatnonzero(inside)
    return slice(int(held[0]), int(held[-1]) + 1) if held.size else slice(0, 0)


def own_aperture_weights(radar: Radar, place: F64, pulses: slice, window: Window) -> F64:
    """Azimuth weight of some pulses in the own apertures of places (..., 3), m: (..., n) float64."""
    forward, center, gap = (part[pulses] for part in flight(radar))
    line = place[..., None, :] - radar.track.position[pulses]
    distance = np.linalg.norm(line, axis=-1)
    sine = np.sum(line * forward, axis=-1) / distance
    step = np.maximum(np.abs(gap * (1.0 - sine**2) / distance + beam_turn(radar)[pulses]), 1e-30)
    return band_weights(sine - center, step, radar.half_aperture, window)


@lru_cache(maxsize=8)
def _whole_aperture(n_pulses: int, window: Window, _function: Callable[..., F64]) -> F64:
    """Weights (n_pulses,) over all pulses; the function is that of the window's name, for the cache."""
    return window.aperture(n_pulses)


def matched_weights(radar: Radar, point: ArrayLike, azimuth_window: str | Window = "rectangular") -> F64:
    """Weight w g^2 of every pulse in backprojection's pixel at points (..., 3), giving (..., n_pulses) float64."""
    if np.isinf(radar.half_aperture):
        w = aperture_weights(radar, point, azimuth_window)
        return np.asarray(w * direction_gain(radar, slice(None), look_directions(radar, point)) ** 2)
    place = np.asarray(point, dtype=np.float64)
    pulses = _serving(radar, place)
    gain = direction_gain(radar, pulses, look_directions(radar, place, pulses))
    weights = np.zeros((*place.shape[:-1], radar.track.n_pulses))
    weights[..., pulses] = own_aperture_weights(radar, place, pulses, parse_window(azimuth_window)) * gain**2
    return weights


def weights_difference(radar: Radar, point: ArrayLike, weights: F64) -> float:
    """Relative power of the difference to backprojection's pixels because of different pulse weights.

    Parameters
    ----------
    radar : gives track, antenna and receive window
    point : (..., 3) m, the image's places
    weights : (..., n_pulses) of the other focuser there, without a window

    Returns
    -------
    largest over the places, relative to the pixel's power; pulses whose window does not contain the place count as
    missing. Infinite where a place is nearly outside the beam and shows only side lobes of others
    """
    distance = np.linalg.norm(
        np.asarray(point, dtype=np.float64)[..., None, :] - radar.track.position, axis=-1
    )
    start = radar.window.start_range
    last = start + (radar.window.n_samples - 1) * radar.window.sample_spacing
    held = (distance >= start) & (distance <= last)
    exact = matched_weights(radar, point) * held
    total = exact.sum(axis=-1, keepdims=True)
    if _dark(total):
        return float("inf")
    exact = exact / total
    other = weights * held / np.maximum(weights.sum(axis=-1, keepdims=True), 1e-300)
    return float((np.sum((other - exact) ** 2, axis=-1) / np.sum(exact**2, axis=-1)).max())


def image_places(grid: ImageGrid, shape: tuple[int, int] = (5, 5)) -> F64:
    """Points over the image including its edges and corners, (n, 3) m; ``shape``: number of rows and columns."""
    rows, columns = (
        np.unique(np.linspace(0, n - 1, most).astype(int)) for n, most in zip(grid.shape, shape, strict=True)
    )
    return np.array([grid.positions_on_line(int(row))[columns] for row in rows]).reshape(-1, 3)


def dimness(radar: Radar, point: F64) -> float:
    """Mean inverse of the summed weight w g^2 at places (n, 3), m, relative to the best illuminated one; at least 1.

    Power gain of errors of single pulses in an image whose pixels are divided by that sum. Places that are not
    illuminated are left out.
    """
    if not radar.antenna.directive and np.isinf(radar.half_aperture):
        return 1.0
    total = np.array([matched_weights(radar, one).sum() for one in point])
    lit = total > _UNLIT * total.max()
    return float(np.mean(total.max() / total[lit])) if lit.any() else 1.0


def ends_rounding(radar: Radar) -> float:
    r"""Relative error power because of float32 sines at the ends of the pixels' apertures.

    A pulse at an end counts by its part within the band, so that an error :math:`\epsilon` of the sine is one of
    :math:`\epsilon / \Delta` of its weight, :math:`\Delta` the step to the next pulse's. Of :math:`2 s_a / \Delta`
    pulses two are at an end: :math:`\epsilon^2 / \Delta s_a`.
    """
    if np.isinf(radar.half_aperture) or radar.track.n_pulses < 2:
        return 0.0
    forward, _, gap = flight(radar)
    line = radar.aim_point - radar.track.position
    distance = np.linalg.norm(line, axis=1)
    ahead = np.sum(line * forward, axis=1) / distance
    step = np.abs(gap * (1.0 - ahead**2) / distance + beam_turn(radar))
    # an antenna at rest has no steps
    return _SINE_ROUNDING**2 / max(float(np.median(step)) * radar.half_aperture, _SINE_ROUNDING)


def beam_rounding(radar: Radar) -> float:
    r"""Relative error power because of float32 sines in a narrow beam.

    A gain :math:`2^{-s^2 / w^2}` changes by :math:`2 \ln 2 \, \epsilon / w` at its half-power angle w, for an error
    :math:`\epsilon` of the sine: that of a direction and that of the beam's axis, which all pulses may share.
    """
    if radar.antenna.pattern == "isotropic":
        return 0.0
    return float(np.sum((4.0 * np.log(2.0) * _SINE_ROUNDING * np.array(radar.antenna.per_width)) ** 2))


def leaves_beam(radar: Radar, point: ArrayLike) -> bool:
    """Whether one of the places (..., 3), m, is nearly outside the beam, relative to the best illuminated one.

    A pixel there shows side lobes of other places, at any level.
    """
    return _dark(matched_weights(radar, point).sum(axis=-1))


def _dark(total: F64) -> bool:
    """Whether a summed weight w g^2 is negligible relative to the largest, or all are zero."""
    return bool(total.min() <= DARK * total.max())


def ground_cell_area(
    radar: Radar, point: ArrayLike, weights: F64, range_window: str | Window, *, lit_alike: bool = False
) -> float:
    r"""Noise-equivalent area of the impulse response on the horizontal plane, m^2.

    The image of unit clutter (sigma0 = 1) has this mean intensity,
    :math:`A = \iint |h|^2 dA`, h the impulse response of unit peak. Every pulse t and frequency f samples the ground's
    spectrum at :math:`(4 \pi f / c) \mathbf u_t`, u the horizontal part of the range's gradient, so by Parseval

    .. math:: A = \frac{(2 \pi)^2}{(4 \pi / c)^2}
              \frac{\sum_t W_t^2 / |\mathbf u \times \dot{\mathbf u}| \int V^2 / f \, df}{(\sum_t W_t)^2 (\int V df)^2}

    times :func:`sarmitsuba.signal.focusing.aperture_weights.beam_over_cell`, where a beam is so narrow that it changes
    within the cell.

    Parameters
    ----------
    radar : gives track and waveform
    point : (3,) m, scene frame
    weights : (n_pulses,) weight of every pulse at that point
    range_window : over the band
    lit_alike : all clutter of the cell has the antenna's gain at the point, as in an image made without the pattern

    Raises
    ------
    DataError
        The aperture does not turn about the point (fewer than two pulses, or flight straight at it).

    Notes
    -----
    Ignores the PRF's azimuth ambiguities and, for pulses near the horizontal line of sight, the wavefront's curvature
    over the cell.
    """
    if radar.track.n_pulses < 2:
        raise DataError("focus: 1 pulse gives no synthetic aperture; at least 2 are needed for an image")
    narrow = 1.0 if lit_alike else beam_over_cell(radar, np.asarray(point, dtype=np.float64), weights)
    pulses = _select_pulses(radar, point, weights)
    u, weights = _sort_by_direction(range_gradients(radar, point, pulses)[:, :2], weights[pulses])
    seen = weights > 0.0
    turn = np.zeros(1)
    if u.shape[0] > 1:
        turn = np.abs(u[:, 0] * np.gradient(u[:, 1]) - u[:, 1] * np.gradient(u[:, 0]))
    if not seen.any() or turn[seen].min() < 1e-15:
        raise DataError(
            "focus: the line of sight to the image's centre does not change its direction, or no pulse illuminates it; "
            "move the image into the beam and away from the flight line"
        )
    wave, window = radar.waveform, parse_window(range_window)
    band = _average_over_band(wave.center_frequency, wave.bandwidth, window, WINDOWS[window.name].function)
    aperture = float(np.sum(weights[seen] ** 2 / turn[seen]) / weights.sum() ** 2)
    return aperture * band * (SPEED_OF_LIGHT / 2.0) ** 2 * narrow


def _select_pulses(radar: Radar, point: ArrayLike, weights: F64) -> slice:
    """Pulses of any weight at a point and one more on either side, for differences; all where directions come again."""
    held = np.flatnonzero(weights)
    x, y = (p - a for p, a in zip(np.asarray(point)[:2], radar.track.position.T[:2], strict=True))
    turn = x[:-1] * y[1:] - x[1:] * y[:-1]
    if not held.size or radar.receiver is not None or not (turn.min() > 0.0 or turn.max() < 0.0):
        return slice(None)
    return slice(max(int(held[0]) - 1, 0), int(held[-1]) + 2)


@lru_cache(maxsize=64)
def _average_over_band(
    center: float, bandwidth: float, window: Window, _function: Callable[..., F64]
) -> float:
    r""":math:`\int V^2 / f \, df / (\int V df)^2`, s^2; the function is that of the window's name, for the cache."""
    v = (np.arange(1024) + 0.5) / 1024 - 0.5
    f = center + bandwidth * v
    V = window(v)
    return float(np.mean(V**2 / f) / (np.mean(V) ** 2 * bandwidth))


def _sort_by_direction(u: F64, weights: F64) -> tuple[F64, F64]:
    """Horizontal lines of sight sorted by angle, with pulses from the same direction merged.

    A radar at rest, or on a track there and back, samples the same spectrum repeatedly: its weights add.
    """
    angle = np.unwrap(np.arctan2(u[:, 1], u[:, 0]))
    order = np.argsort(angle, kind="stable")
    new = np.concatenate([[True], np.diff(angle[order]) > 1e-12])
    return u[order][new], np.asarray(np.bincount(np.cumsum(new) - 1, weights[order]))


def incidence_angle(radar: Radar, point: ArrayLike) -> F64:
    """Angle between the vertical and the line of sight from mid-aperture at points (..., 3), rad."""
    line = radar.track.center_position - np.asarray(point, dtype=np.float64)
    return np.asarray(np.arccos(np.clip(line[..., 2] / np.linalg.norm(line, axis=-1), -1.0, 1.0)))
