"""Block synthesis: paths are added once to a (range, range rate) grid, from which all K pulses are computed.

Curvature of slant ranges within a block is fitted to the track's geometry. Every pulse has its azimuth pattern, as a
function of the range rate, for which the grid's cells are small enough.
"""

from dataclasses import dataclass

import numpy as np
import scipy.fft
from numpy.typing import NDArray

from sarmitsuba.core.arrays import C64, F64, unit_rows
from sarmitsuba.core.constants import SPEED_OF_LIGHT
from sarmitsuba.core.units import amplitude_from_db, db_from_amplitude, db_from_power, power_from_db
from sarmitsuba.radar.antenna import Pointing
from sarmitsuba.radar.radar import Radar
from sarmitsuba.radar.track import Track
from sarmitsuba.signal.direct import box_distance
from sarmitsuba.signal.gridding import FineGrid, GriddingKernel, fine_grid, gridding_kernel
from sarmitsuba.signal.pulse_motion import InPulse, widest_shift
from sarmitsuba.signal.threads import one_blas_thread

# error of the azimuth pattern at the ends of a block, dB; 5 dB less in the mean over its pulses
_BEAM_DB = -48.0


def step_within_beam(radar: Radar, start: int, stop: int, kernel: GriddingKernel, s_max: float) -> float:
    r"""Largest cell along the range rate for the azimuth pattern, m/s; infinite without a pattern.

    A path is spread over several cells, each of which is weighted by its own value g of the pattern. With the kernel's
    second moment :math:`m_2`, the two leading error terms at the pulse of phase slope s are

    .. math:: \tfrac12 g'' m_2 \Delta^2, \qquad g' m_2 s \Delta^2

    with the largest derivatives of the pattern. Both are kept at ``_BEAM_DB``.
    """
    if not radar.antenna.directive:
        return float(np.inf)
    taps = np.asarray(kernel.taps(np.array(0.5)))
    distance = np.arange(kernel.width) - kernel.lead - 0.5
    second_moment = max(float(taps @ distance**2 / taps.sum()), 0.25)
    speed = float(np.linalg.norm(radar.track.velocity[start:stop], axis=1).min())
    width = float(np.sin(0.5 * radar.antenna.azimuth_beamwidth)) * speed
    slope, bend = radar.antenna.azimuth_bends
    change = 0.5 * bend / width**2 + slope * s_max / width
    return float(np.sqrt(amplitude_from_db(_BEAM_DB) / (change * second_moment)))


def azimuth_gain(radar: Radar, pulses: slice, reference: F64, range_rate: F64) -> F64:
    r"""Two-way azimuth pattern of pulses over range rates, (n_range_rate, n_pulses) float64.

    The range rate is the speed times the sine of a path's angle off the zero-Doppler plane, so it gives the direction
    of the path at every pulse: along the unit vector

    .. math:: u = -\frac{\dot R}{v} \hat v + \sqrt{1 - (\dot R / v)^2}\, \hat b_\perp

    with :math:`\hat b_\perp` the boresight's direction across the velocity. With two antennas each contributes the root
    of its pattern, at its own speed and boresight.

    Parameters
    ----------
    radar : with its antennas
    pulses : of a block
    reference : (3,) m, scene frame
    range_rate : (n,) m/s, less that of ``reference``

    Notes
    -----
    Ignores the elevation within the azimuth pattern. For paths whose first and last leg have different directions the
    pattern is that at their mean; the rays carry the correction. For two antennas it ignores that the range rates of
    their legs, relative to ``reference``, differ by about the bistatic angle times the scene's angular size.
    """
    gains = [
        _leg_gain(radar, track, pointing, pulses, reference, range_rate)
        for track, pointing in zip(radar.tracks, radar.pointings, strict=True)
    ]
    return gains[0] if len(gains) == 1 else np.sqrt(gains[0] * gains[1])


def _leg_gain(
    radar: Radar, track: Track, pointing: Pointing, pulses: slice, reference: F64, rate: F64
) -> F64:
    """Two-way pattern (squared) of one antenna."""
    position, velocity = track.position[pulses], track.velocity[pulses]
    speed = np.linalg.norm(velocity, axis=1)
    ahead = velocity / speed[:, None]
    leg = reference - position
    reference_rate = -np.einsum("ki,ki->k", leg, velocity) / np.linalg.norm(leg, axis=1)
    sine = np.clip(-(rate[:, None] + reference_rate) / speed, -1.0, 1.0)
    boresight = pointing.boresight[pulses]
    across = boresight - np.einsum("ki,ki->k", boresight, ahead)[:, None] * ahead
    across = unit_rows(across)
    cosine = np.sqrt(1.0 - sine * sine)

    def component(axis: F64) -> F64:
        along, beside = np.einsum("ki,ki->k", ahead, axis), np.einsum("ki,ki->k", across, axis)
        return np.asarray(sine * along + cosine * beside)

    azimuth = component(pointing.azimuth_axis[pulses])
    gain = radar.antenna.two_way_amplitude(azimuth, np.zeros_like(azimuth))
    return np.asarray(np.where(component(boresight) > 0.0, gain, 0.0))


_RANGE_DEGREE, _RATE_DEGREE = 4, 3
_HELD = (
    1.25  # beyond this multiple of the fitted span the polynomials are constant: only kernel tails lie there
)


@dataclass(frozen=True, eq=False)
class Curvature:
    r"""Curvature: slant range beyond ``R0 + range_rate tau``, per pulse, as a function of range plus one of range rate.

    .. math:: c(R_0, \dot R, t_k) = \sum_n a_{nk} x^n + \sum_{n \ge 1} b_{nk} y^n, \quad
              x = (R_0 - R_c) / R_s, \; y = (\dot R - \dot R_c) / \dot R_s

    Parameters
    ----------
    range_center, range_scale : m
    range_rate_center, range_rate_scale : m/s
    by_range : (n_degree + 1, K) float64, m, constant first
    by_range_rate : (n_degree, K) float64, m, without a constant
    """

    range_center: float
    range_scale: float
    range_rate_center: float
    range_rate_scale: float
    by_range: F64
    by_range_rate: F64

    def of_range(self, range_offset: NDArray[np.floating]) -> F64:
        """Part by range at the offsets R0 (n,), m: (K, n)."""
        x = np.clip((range_offset - self.range_center) / self.range_scale, -_HELD, _HELD)
        return np.asarray(np.polynomial.polynomial.polyval(x, self.by_range))

    def of_range_rate(self, range_rate: NDArray[np.floating]) -> F64:
        """Part by range rate at (n,) m/s: (K, n)."""
        y = np.clip((range_rate - self.range_rate_center) / self.range_rate_scale, -_HELD, _HELD)
        return np.asarray(y * np.polynomial.polynomial.polyval(y, self.by_range_rate))

    @property
    def slope(self) -> F64:
        """Derivative of the part by range at the centre, (K,)."""
        return np.asarray(self.by_range[1] / self.range_scale)


@dataclass(frozen=True, eq=False)
class KeyState:
    """State of the antennas at a block's key pulse: one antenna, or transmitter and receiver.

    Parameters
    ----------
    key : number of the pulse
    position, velocity : (n_antennas, 3) float64, m and m/s, scene frame; the velocity is that of the best line through
        the block's positions
    tau : (K,) float64, s, effective time of every pulse on that line, from the key pulse
    """

    key: int
    position: F64
    velocity: F64
    tau: F64

    def slant_range(self, point: F64) -> float:
        """Slant range of a point (3,), m: mean of the distances to both antennas."""
        return float(np.linalg.norm(point - self.position, axis=-1).mean())

    def rate(self, point: F64) -> float:
        """Range rate of a point (3,), m/s."""
        legs = self.position - point
        return float((np.einsum("ai,ai->a", legs, self.velocity) / np.linalg.norm(legs, axis=-1)).mean())


def key_state(radar: Radar, start: int, stop: int) -> KeyState:
    """State at a block's key pulse, from the best line through its pulses.

    The times are those of the projections of the pulse positions onto the line, which also covers antennas at rest or
    with varying speed. The residual is then small, as the grid over range rates requires.
    """
    key, tracks = start + (stop - start) // 2, radar.tracks
    positions = np.concatenate([track.position[start:stop] for track in tracks], axis=1)
    position, time = positions[key - start], radar.track.time
    tau = time[start:stop] - time[key]
    if stop - start < 2:
        velocity = np.concatenate([track.velocity[key] for track in tracks])
    else:
        centered = tau - tau.mean()
        velocity = centered @ (positions - position) / (centered @ centered)
        square = float(velocity @ velocity)
        if square > 0.0:
            tau = (positions - position) @ velocity / square
    return KeyState(key, position.reshape(-1, 3), np.asarray(velocity).reshape(-1, 3), tau)


def sample_paths(box: F64, antenna: F64, extra: float) -> tuple[F64, F64]:
    """Sample paths of the box as pairs of points, slant range = mean of the distances to both.

    Direct returns and corner reflectors have identical points. A mirror chain shifts its image point along the line
    of sight, behind the first hit, by at most ``2 * extra`` when only one of the two legs is mirrored, ``extra``
    when both are.
    """
    axes = [np.linspace(box[0, i], box[1, i], n) for i, n in enumerate((7, 7, 3))]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    if extra <= 0.0:
        return points, points
    sight = points - antenna
    sight = unit_rows(sight)
    rng = np.random.default_rng(0)
    partner = np.clip(points + rng.uniform(-2.0 * extra, 2.0 * extra, points.shape), box[0], box[1])
    images = [points, points + 0.5 * extra * sight, points + extra * sight, points + 2.0 * extra * sight]
    others = [points, points + 0.5 * extra * sight, points + extra * sight, partner]
    # longer paths than allowed are excluded
    a, b = np.concatenate(images), np.concatenate(others)
    half = 0.5 * (np.linalg.norm(a - antenna, axis=-1) + np.linalg.norm(b - antenna, axis=-1))
    keep = half <= np.linalg.norm(points - antenna, axis=-1).max() + extra
    return a[keep], b[keep]


@dataclass(frozen=True, eq=False)
class CurvatureFit:
    """Result of :func:`fit_curvature`.

    Parameters
    ----------
    curvature : the fitted polynomials
    range_rate : (n_samples,) float64, m/s, of the sample paths
    error : (n_samples,) float64, rad^2, mean square phase error over the block's pulses
    """

    curvature: Curvature
    range_rate: F64
    error: F64


def fit_curvature(radar: Radar, start: int, stop: int, reference: F64, a: F64, b: F64) -> CurvatureFit:
    """Curvature fitted to the exact slant ranges of sample paths; a, b (n_samples, 3)."""
    state = key_state(radar, start, stop)
    tau = state.tau
    # with two antennas the incident leg is the transmitter's, the scattered leg the receiver's
    out, back = 0, len(radar.tracks) - 1

    def distance(p: F64, antenna: int) -> F64:
        track = radar.tracks[antenna].position[start:stop]
        leg = [
            p[:, None, i] - track[:, i] for i in range(3)
        ]  # summed over three axes, norm() takes four times as long
        return np.asarray(np.sqrt(leg[0] * leg[0] + leg[1] * leg[1] + leg[2] * leg[2]))

    def slope(p: F64, antenna: int) -> F64:
        d = state.position[antenna] - p
        return np.asarray(d @ state.velocity[antenna] / np.linalg.norm(d, axis=-1))

    there = reference[None]
    offset = 0.5 * (distance(a, out) + distance(b, back))
    offset -= 0.5 * (distance(there, out) + distance(there, back))
    range0 = offset[:, state.key - start]
    range_rate = 0.5 * (slope(a, out) + slope(b, back)) - 0.5 * (slope(there, out) + slope(there, back))
    residual = offset - range0[:, None] - range_rate[:, None] * tau

    def center_scale(v: F64, least: float) -> tuple[float, float]:
        return 0.5 * float(v.max() + v.min()), max(0.5 * float(np.ptp(v)), least)

    rc, rs = center_scale(range0, radar.waveform.range_cell)
    vc, vs = center_scale(range_rate, radar.waveform.wavelength / max(4.0 * float(np.abs(tau).max()), 1e-9))
    x, y = (range0 - rc) / rs, (range_rate - vc) / vs
    basis = np.concatenate(
        [x[None] ** np.arange(_RANGE_DEGREE + 1)[:, None], y[None] ** np.arange(1, _RATE_DEGREE + 1)[:, None]]
    )
    with one_blas_thread():  # small products: threads would only wait for each other
        # normal equations of a few scaled monomials: ten times quicker than an SVD of all samples, and the pseudo-
        # inverse drops what a flat box cannot tell apart
        normal = np.linalg.pinv(basis @ basis.T, rcond=1e-13, hermitian=True)
        coefficients = normal @ (basis @ residual)
        model = basis.T @ coefficients
    # the correction is exact at the carrier and to first order across the band: mean of (k_f a)^4 / 4
    wavenumber = 4.0 * np.pi / SPEED_OF_LIGHT
    at_carrier = wavenumber * radar.waveform.center_frequency * (residual - model)
    over_band = 0.5 * (0.5 * wavenumber * radar.waveform.bandwidth * model) ** 2 / np.sqrt(5.0)
    n = _RANGE_DEGREE + 1
    return CurvatureFit(
        Curvature(rc, rs, vc, vs, coefficients[:n], coefficients[n:]),
        range_rate,
        np.asarray(np.mean(at_carrier**2 + over_band**2, axis=1)),
    )


_GUARD = 48
# error of the synthesis itself, dB: shifts by the curvature are first order over the band; its range-rate part has none
_LEFT_DB = -84.0


@dataclass(frozen=True, eq=False)
class BlockPlan:
    r"""Grid and geometry of one block of pulses ``start:stop`` about the key pulse ``key``.

    A path of slant range h and amplitude a (constant within the block) is added once. With the antennas in their
    ``state`` of the key pulse::

        R0 = h - reference_range                                   (float64)
        range_rate = dh/dt - reference_rate
        x = (R0 - range0) / range_step,  y = (range_rate - range_rate0) / range_rate_step
        grid[layer, i, j] += a exp(-j 4 pi fc R0 / c) phi(x - i) phi(y - j)

    with ``phi`` the taps of ``kernel`` along range and of ``range_rate_kernel`` along the range rate. Contributions
    must satisfy ``margin <= x <= n_range - 1 - margin`` and alike for y, with the kernels' ``margin``; the box
    given to ``plan_block`` guarantees it for all paths that stay inside, anything else must be masked.

    Parameters
    ----------
    key, start, stop : pulse indices; ``start <= key < stop``
    state : antennas at the key time; ``range_rate`` refers to its velocities, not to those of the tracks
    reference : (3,) float64, m, scene frame; P_ref
    reference_range, reference_rate : slant range of ``reference`` at the key time, m, and its change, m/s
    range0, range_step, n_range : slant range of cell 0, cell (m) and number of cells along range
    range_rate0, range_rate_step, n_range_rate : the same along the range rate, m/s
    width, range_rate_width : of the gridding kernels
    n_inner : length of the FFT over the grid's range axis
    guard : cells before the grid within ``n_inner``, for the compact response and the range walk
    fine : resampling of the profiles to the window's samples
    curvature : slant range beyond ``R0 + range_rate tau``
    geometry_error_db : worst over the box's sample points of the rms phase error over the block, dB
    kernel_error_db : rms error of the two gridding kernels, dB
    in_pulse : motion of the antenna within the key pulse; None: start-stop approximation
    """

    start: int
    stop: int
    state: KeyState
    reference: F64
    reference_range: float
    reference_rate: float
    range0: float
    n_range: int
    range_rate0: float
    range_rate_step: float
    n_range_rate: int
    width: int
    range_rate_width: int
    n_inner: int
    guard: int
    fine: FineGrid
    curvature: Curvature
    geometry_error_db: float
    kernel_error_db: float
    in_pulse: InPulse | None = None

    @property
    def key(self) -> int:
        """Number of the key pulse."""
        return self.state.key

    @property
    def tau(self) -> F64:
        """Pulse times (K,) relative to the key pulse, float64, s."""
        return self.state.tau

    @property
    def range_step(self) -> float:
        """Cell along range, m."""
        return self.fine.range_step

    @property
    def n_pulses(self) -> int:
        """Number of pulses of the block, K."""
        return self.stop - self.start

    @property
    def predicted_error_db(self) -> float:
        """Expected relative error of geometry, kernels and synthesis together, dB."""
        parts = (self.geometry_error_db, self.kernel_error_db, _LEFT_DB)
        return db_from_power(sum(power_from_db(part) for part in parts))

    @property
    def kernel(self) -> GriddingKernel:
        """Gridding kernel along range."""
        return gridding_kernel(self.width)

    @property
    def range_rate_kernel(self) -> GriddingKernel:
        """Gridding kernel along the range rate."""
        return gridding_kernel(self.range_rate_width)

    def shape(self, n_layers: int) -> tuple[int, int, int]:
        """Shape of the complex64 grid, (n_layers, n_range, n_range_rate)."""
        return (n_layers, self.n_range, self.n_range_rate)


def plan_block(
    radar: Radar,
    start: int,
    stop: int,
    reference: F64,
    box: F64,
    width: int = 4,
    *,
    extra_slant_range: float = 0.0,
    extra_range_rate: float = 0.0,
    range_rate_width: int | None = None,
) -> BlockPlan:
    """Plan of a block: grid of the pulses ``start:stop``, and curvature fitted over the box.

    Parameters
    ----------
    radar : track, waveform and window
    start, stop : pulse indices
    reference : (3,) float64, m, scene frame; P_ref, best near the middle of the box
    box : (2, 3) float64, m, scene frame; bounds of all phase centres
    width, range_rate_width : of the gridding kernels along range and range rate (default: the same)
    extra_slant_range : half the largest extra path length by multiple reflections, m
    extra_range_rate : largest change of a range rate by motion in the scene, m/s

    Notes
    -----
    Ignores changes of a path's amplitude within the block (beam, spreading, visibility).
    The curvature is the least-squares fit, pulse by pulse, of the exact slant ranges of sample paths: points
    throughout the box and, with ``extra_slant_range``, mirror images behind it and pairs of both. It is valid for
    any track; the residual is the plan's ``geometry_error_db``.
    """
    reference = np.asarray(reference, dtype=np.float64)
    box = np.asarray(box, dtype=np.float64)
    range_rate_width = width if range_rate_width is None else range_rate_width
    cell, window, fc = radar.waveform.range_cell, radar.window, radar.waveform.center_frequency
    state = key_state(radar, start, stop)
    centers, partners = sample_paths(box, state.position[0], extra_slant_range)
    if len(state.position) > 1:  # the leg of either antenna may be the mirrored one
        centers, partners = np.concatenate([centers, partners]), np.concatenate([partners, centers])
    fit = fit_curvature(radar, start, stop, reference, centers, partners)

    # range axis: exact bounds of the box; range-rate axis: those of the samples and 2 % more
    reference_range = state.slant_range(reference)
    near, far = (float(d.mean()) for d in box_distance(box, state.position))
    far += extra_slant_range
    slack = 0.02 * np.ptp(fit.range_rate) + 1e-9 * float(np.linalg.norm(state.velocity[0])) + extra_range_rate
    range_rate_low, range_rate_high = float(fit.range_rate.min() - slack), float(fit.range_rate.max() + slack)
    kernel, range_rate_kernel = gridding_kernel(width), gridding_kernel(range_rate_width)
    reach = float(np.abs(state.tau).max())
    s_max = 4.0 * np.pi * (fc + 0.5 * radar.waveform.bandwidth) / SPEED_OF_LIGHT * reach
    range_rate_step = 0.5 * np.pi / s_max if s_max > 0.0 else max(range_rate_high - range_rate_low, 1.0)
    range_rate_step = min(range_rate_step, step_within_beam(radar, start, stop, range_rate_kernel, s_max))
    n_range_rate = (
        int(np.ceil((range_rate_high - range_rate_low) / range_rate_step)) + 2 * range_rate_kernel.margin + 2
    )

    # the window against the block's contributions, both relative to the reference range of each pulse
    walk = max(abs(range_rate_low), abs(range_rate_high)) * reach + 2.0 * cell
    walk += widest_shift(radar, box, slice(start, stop))
    reference_track = radar.slant_range(reference, slice(start, stop))
    first = window.start_range[start:stop] - reference_track
    low = float(first.min()) - (far - reference_range) - walk
    high = float(first.max()) + window.extent - (near - reference_range) + walk
    guard = _GUARD + int(np.ceil(walk / (0.5 * cell) * 1.05))
    n_cells = int(np.ceil((far - near) / (0.5 * cell) * 1.05)) + 2 * kernel.margin + 2
    fine = fine_grid(cell, window.sample_spacing, low, high, int(1.1 * (n_cells + 2 * guard)) + 8)
    n_range = int(np.ceil((far - near) / fine.range_step)) + 2 * kernel.margin + 2
    n_inner = min(int(scipy.fft.next_fast_len(n_range + 2 * guard)), fine.n_fine)
    error = float(np.sqrt(fit.error.max()))
    return BlockPlan(
        start=start,
        stop=stop,
        state=state,
        reference=reference,
        reference_range=reference_range,
        reference_rate=state.rate(reference),
        range0=near - reference_range - (kernel.margin + 0.5) * fine.range_step,
        n_range=n_range,
        range_rate0=range_rate_low - (range_rate_kernel.margin + 0.5) * range_rate_step,
        range_rate_step=range_rate_step,
        n_range_rate=n_range_rate,
        width=width,
        range_rate_width=range_rate_width,
        n_inner=n_inner,
        guard=guard,
        fine=fine,
        curvature=fit.curvature,
        geometry_error_db=db_from_amplitude(max(error, 1e-10)),
        kernel_error_db=_kernel_error_db(width, range_rate_width),
        in_pulse=InPulse.of(radar, slice(state.key, state.key + 1)),
    )


def choose_block_length(
    radar: Radar,
    reference: F64,
    box: F64,
    width: int = 4,
    target_error_db: float = -40.0,
    *,
    extra_slant_range: float = 0.0,
    max_length: int = 128,
    max_cells: int = 2**22,
) -> int:
    """Largest block length K whose error is below the target all along the track; 1 where there is none.

    The error of every block examined (all of them, or 24 spread over a long track) is the worst one of the
    box's sample paths, exact slant ranges against the model, and the kernels'. A kernel too narrow for the
    target counts as meeting it, since shorter blocks would not reduce its error. Blocks shorter than 8 pulses
    cost more than the direct accumulator and are not considered.

    Parameters
    ----------
    target_error_db : relative rms error of the data, dB, below 0
    max_length : largest K to try, apart from the sixteenth that may avoid a last block of few pulses
    max_cells : bound on the cells of one layer's grid
    (the others as for :func:`plan_block`)
    """
    n_pulses = radar.track.n_pulses
    kernel = power_from_db(_kernel_error_db(width, width))
    budget = power_from_db(least_error_db(width, target_error_db)) - kernel
    for longest in (512, 384, 256, 192, 128, 96, 64, 48, 32, 24, 16, 12, 8):
        if longest > max_length or longest > n_pulses:
            continue
        length = _even(n_pulses, longest)
        starts = np.unique(np.linspace(0, n_pulses - length, min(-(-n_pulses // length), 24)).astype(int))
        order = np.argsort(-np.abs(starts - 0.5 * (n_pulses - length)))  # the outermost fail first
        if all(
            # a block reaches up to the first pulse of the next one
            _holds(
                radar,
                int(s),
                min(length + 1, n_pulses - int(s)),
                reference,
                box,
                extra_slant_range,
                budget,
                width,
                max_cells,
            )
            for s in starts[order]
        ):
            return length
    return 1


def _even(n_pulses: int, length: int) -> int:
    """Block length of about ``length``, up to a sixteenth more, such that no short block remains.

    A short block would cost a tracing like all others, and a separate kernel for the size of its grid.
    """
    count = max(1, int(np.ceil(n_pulses / length - 1.0 / 16.0)))
    return -(-n_pulses // count)


def least_error_db(width: int, target_error_db: float) -> float:
    """Error bound for blocks, dB: the target, or twice the error power of kernels of this width."""
    return max(target_error_db, _kernel_error_db(width, width) + db_from_power(2.0))


def _holds(
    radar: Radar,
    start: int,
    length: int,
    reference: F64,
    box: F64,
    extra: float,
    budget: float,
    width: int,
    max_cells: int,
) -> bool:
    plan = plan_block(radar, start, start + length, reference, box, width, extra_slant_range=extra)
    if power_from_db(plan.geometry_error_db) > budget:
        return False
    return plan.n_range * plan.n_range_rate <= max_cells


def _kernel_error_db(width: int, range_rate_width: int) -> float:
    power = sum(power_from_db(gridding_kernel(w).error_db) for w in (width, range_rate_width))
    return db_from_power(power)


def spread_reference(
    plan: BlockPlan,
    radar: Radar,
    range_offset: F64,
    range_rate: F64,
    amplitude: NDArray[np.complexfloating],
) -> C64:
    """Spread paths in NumPy as the tracing kernel does, for tests and small jobs.

    Parameters
    ----------
    range_offset : (n_paths,) float64, m; R0 of the plan
    range_rate : (n_paths,) float64, m/s
    amplitude : (n_layers, n_paths) complex, sqrt(W)

    Returns
    -------
    (n_layers, n_range, n_range_rate) complex64
    """
    kernels = (plan.kernel, plan.range_rate_kernel)
    position = (
        (range_offset - plan.range0) / plan.range_step,
        (range_rate - plan.range_rate0) / plan.range_rate_step,
    )
    base = [np.floor(p + k.shift) for p, k in zip(position, kernels, strict=True)]
    taps = [k.taps(p + k.shift - q) for p, q, k in zip(position, base, kernels, strict=True)]
    i, j = (q.astype(np.int64) - k.lead for q, k in zip(base, kernels, strict=True))
    wavenumber = 4.0 * np.pi * radar.waveform.center_frequency / SPEED_OF_LIGHT
    phase_factor = np.exp(-1j * np.mod(wavenumber * range_offset, 2.0 * np.pi))
    grid = np.zeros(plan.shape(len(amplitude)), dtype=np.complex128)
    for layer, a in enumerate(amplitude):
        for p in range(plan.width):
            for q in range(plan.range_rate_width):
                np.add.at(grid[layer], (i + p, j + q), a * phase_factor * taps[0][p] * taps[1][q])
    return grid.astype(np.complex64)
