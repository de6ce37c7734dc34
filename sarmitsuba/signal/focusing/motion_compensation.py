"""Motion compensation: conversion of data from a recorded track to a straight, level, uniform track."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
import scipy.fft
from numpy.typing import NDArray

from sarmitsuba.core.arrays import C64, C128, F32, F64, I64, LinearMap, unit_rows
from sarmitsuba.core.errors import DataError
from sarmitsuba.core.parameters import did_you_mean
from sarmitsuba.core.units import db_from_power
from sarmitsuba.radar.antenna import Pointing
from sarmitsuba.radar.radar import Radar, ReceiveWindow
from sarmitsuba.radar.track import Track
from sarmitsuba.signal.focusing.aperture_weights import direction_gain
from sarmitsuba.signal.focusing.focuser import Focuser, check_focuser
from sarmitsuba.signal.focusing.frequency_domain.turning import lit_from_orbit, turns
from sarmitsuba.signal.gridding import gridding_kernel
from sarmitsuba.signal.image import ImageGrid
from sarmitsuba.signal.raw_data import RawData

MOTION_COMPENSATIONS = ("auto", "off")
# largest residual phase after compensation for the beam's centre at any pixel of the image, rad
LARGEST_RESIDUAL = 0.25 * np.pi
# taps of the kernel that resamples along range and track, after doubling the rate: below -120 dB
_WIDTH = 8
# zeros beyond the ends of pulses and of the track while they are resampled
_GUARD = 64
# two-way amplitude of the beam above which a pulse counts for a pixel
_LIT = 0.05
# change from one interval between pulses to the next, over their mean, that resampling over the pulse's number allows:
# the error is at most 2 pi times that share of a turn, -24 dB at half the prf
_UNEVEN = 0.02
# of the ripple of echoes cut by the receive window, see _cut_echoes; held by benchmarks/suite/stated_errors.py
_CUT_PART = 0.1
# margin of the stated error over the largest at the sampled pixels, dB
_MARGIN_DB = 3.0
_BATCH = 1 << 20


@dataclass(frozen=True, eq=False)
class Straightening:
    """Recorded track and the straight line that replaces it.

    Parameters
    ----------
    radar : as recorded
    straight : the radar on the line: uniform pulses, its window moving with the reference range
    origin, along : (3,) float64, m; a point of the line, and its horizontal direction
    x : (n_pulses,) float64, m, positions of the recorded pulses along the line
    aim : (along the line m, across it m, below it m) of the reference point, or with beams that pass over the pixels
        one after the other (0, ...) of a point that moves with the antenna
    sine : along the line, of the reference point that moves with the antenna; None where it is fixed
    height : of the image plane, m
    """

    radar: Radar
    straight: Radar
    origin: F64
    along: F64
    x: F64
    aim: F64
    sine: float | None
    height: float

    @property
    def line(self) -> F64:
        """(n_pulses, 3) foot points of the recorded positions on the line."""
        return np.asarray(self.origin + self.x[:, None] * self.along)

    @property
    def uniform(self) -> F64:
        """Uniform positions (n_pulses,) of the compensated pulses along the line, m."""
        return np.asarray((self.straight.track.position - self.origin) @ self.along)

    @property
    def place(self) -> F64:
        """Fractional numbers (n_pulses,) of the recorded pulses at the uniform positions."""
        return np.asarray(np.interp(self.uniform, self.x, np.arange(self.x.size)))

    @property
    def largest_displacement(self) -> float:
        """Largest distance of a recorded position from the line, m."""
        return float(np.linalg.norm(self.radar.track.position - self.line, axis=1).max())

    def reference_history(self, x: F64) -> F64:
        """Range history of the reference point along the line, without a constant, m."""
        if self.sine is not None:
            return -self.sine * x
        return np.asarray(np.hypot(x - self.aim[0], np.hypot(self.aim[1], self.aim[2])))

    def points(self, x: F64, slant: F64) -> F64:
        """Points of the image plane at slant ranges from positions x on the line, towards the reference.

        Parameters
        ----------
        x, slant : broadcast against each other, m; ranges shorter than the height above the plane count as nadir's
        """
        drop = self.origin[2] - self.height
        if self.sine is None:
            ahead = self.aim[0] - x
            sine = ahead / np.sqrt(ahead**2 + self.aim[1] ** 2 + self.aim[2] ** 2)
        else:
            sine = np.broadcast_to(self.sine, x.shape)
        ahead = sine * slant
        across = np.sqrt(np.clip(slant**2 - ahead**2 - drop**2, 0.0, None))
        foot = self.origin + (x + ahead)[..., None] * self.along + across[..., None] * self.straight.across
        foot[..., 2] = self.height
        return np.asarray(foot)

    def excess(self, slant: F64) -> F64:
        """Excess range of recorded positions over the line, (n_pulses, n), m, at ``slant`` (n,) or (n_pulses, n).

        For points towards the reference, see :meth:`points`.
        """
        slant = np.broadcast_to(slant, (self.x.size, slant.shape[-1]))
        point = self.points(np.broadcast_to(self.x[:, None], slant.shape), slant)
        true = np.linalg.norm(point - self.radar.track.position[:, None], axis=-1)
        return np.asarray(true - np.linalg.norm(point - self.line[:, None], axis=-1))


def plan_straightening(radar: Radar, grid: ImageGrid) -> Straightening:
    """Straight line along the grid for motion compensation, and the radar on it.

    A slant grid defines the line; on a ground grid it is the level line along the grid through the mean of the track.

    Raises
    ------
    DataError
        The antenna does not move steadily forward along the grid, or its pulse spacing is too uneven.
    """
    track, along = radar.track, grid.along
    mean = track.position.mean(axis=0)
    through = grid.origin if grid.kind == "slant" else mean
    x = (track.position - through) @ along
    if track.n_pulses < 8 or (np.diff(x) <= 0.0).any():
        raise DataError(
            "the antenna does not move steadily forward along the grid, or has fewer than 8 pulses"
        )
    uneven = float(np.abs(np.diff(x, 2)).max() / np.diff(x).mean())
    if uneven > _UNEVEN:
        raise DataError(
            f"neighbouring intervals between pulses differ by up to {100.0 * uneven:.3g} % (bound "
            f"{100.0 * _UNEVEN:g} %), too much to resample the pulses to uniform positions"
        )
    uniform = np.linspace(x[0], x[-1], x.size)
    # the line's own middle is its origin, as a straight track's is its centre position
    origin = through + 0.5 * (x[0] + x[-1]) * along
    x, uniform = x - 0.5 * (x[0] + x[-1]), uniform - 0.5 * (x[0] + x[-1])
    index = np.interp(uniform, x, np.arange(x.size))
    time = np.linspace(track.time[0], track.time[-1], x.size)
    speed = float(x[-1] - x[0]) / float(time[-1] - time[0])
    position = origin + uniform[:, None] * along
    velocity = np.broadcast_to(speed * along, position.shape).copy()
    flown = Track(time, position, velocity, track.epoch)

    middle = grid.positions_on_line(grid.shape[0] // 2)[grid.shape[1] // 2] - origin
    aim = np.array([middle @ along, middle @ radar.across, middle[2]])
    own = np.isfinite(radar.half_aperture)
    nearest = np.clip(np.rint(index).astype(int), 0, x.size - 1)
    pointing = Pointing(
        **{
            name: getattr(radar.pointing, name)[nearest]
            for name in ("boresight", "azimuth_axis", "elevation_axis")
        }
    )
    straight = replace(radar, track=flown, pointing=pointing)
    sine = float((radar.pointing.boresight @ along).mean()) if own else None
    return Straightening(radar, straight, origin, np.asarray(along), x, aim, sine, grid.height)


@dataclass(frozen=True)
class Residual:
    """Residual error of motion compensation at the worst of the sampled pixels.

    Parameters
    ----------
    phase : rad, largest of any pulse
    power : energy of the error of a point's echoes over that of the echoes
    """

    phase: float
    power: float

    @property
    def error_db(self) -> float:
        """Stated relative energy of the error of a point's echoes, dB."""
        return float(db_from_power(self.power)) + _MARGIN_DB


def compensation_residual(plan: Straightening, grid: ImageGrid) -> Residual:
    r"""Residual of motion compensation at the grid's pixels: largest phase, and relative energy of the echoes' error.

    .. math:: \frac{4 \pi}{\lambda} \left| (|A_t - p| - |L_t - p|) - \Delta R_t(|L_t - p|) \right|

    A the recorded positions, L their foot points on the line, :math:`\Delta R` the compensated excess range of
    a point as far away in the direction of the reference. The energy is that of the point's echoes, compensated and
    resampled as data are, minus those from the line, where backprojection gives recorded pulses equal weight; plus the
    change of the beam's gain and the ripple of echoes cut by the receive window. Evaluated at the edges of the image,
    for pulses that illuminate them. Ignores the different direction of scatterers off the image plane.
    """
    rows, columns = (np.unique(np.linspace(0, n - 1, 5).astype(int)) for n in grid.shape)
    points = np.array([grid.positions_on_line(int(row))[columns] for row in rows]).reshape(-1, 3)
    radar = plan.radar
    kc = 4.0 * np.pi / radar.waveform.wavelength
    uniform, place = plan.uniform, plan.place
    # recorded pulses per uniform position
    density = np.mean(np.diff(plan.x)) / np.interp(uniform, plan.x, np.gradient(plan.x))
    phase = power = 0.0
    for point in points:
        leg = point - radar.track.position
        distance = np.linalg.norm(leg, axis=1)
        slant = np.linalg.norm(point - plan.line, axis=1)
        lit = direction_gain(radar, slice(None), leg / distance[:, None]) > _LIT
        if np.isfinite(radar.half_aperture):
            lit &= np.abs((leg @ plan.along) / distance - float(plan.sine or 0.0)) < radar.half_aperture
        if not lit.any():
            continue
        left = distance - plan.excess(slant[:, None])[:, 0]
        phase = max(phase, kc * float(np.abs((left - slant)[lit]).max()))
        echo = np.exp(-1j * kc * (left - plan.reference_history(plan.x))).astype(np.complex64)
        moved = _interpolate_pulses(echo[:, None], place)[:, 0] * np.exp(
            -1j * kc * plan.reference_history(uniform)
        )
        straight = np.linalg.norm(point - plan.straight.track.position, axis=1)
        error = moved * np.exp(1j * kc * straight) - density
        seen = np.interp(uniform, plan.x, lit) > 0.5
        left_here = float(np.square(np.abs(error[seen])).mean())
        power = max(power, left_here + _beam_change(plan, point, leg / distance[:, None]))
    return Residual(phase, power + _cut_echoes(radar, grid))


def _cut_echoes(radar: Radar, grid: ImageGrid) -> float:
    r"""Relative power of the ripple that range shifts cause in echoes cut by the ends of the receive window.

    Shifted pulses are periodic, and tails cut off at one end appear at the other, with an amplitude of
    :math:`1 / \pi d` after d range cells of guard and window. A measured share of the power from scatterers all over
    the window in an image of n cells, :math:`2 / \pi^2 d n`.
    """
    cell, window = radar.waveform.range_cell, radar.window
    cells = max(float(np.ptp(grid.range)) / cell, 1.0)
    away = _GUARD * window.sample_spacing / cell
    return _CUT_PART * 2.0 / (np.pi**2 * away * cells)


def _beam_change(plan: Straightening, point: F64, direction: F64) -> float:
    """Relative power of the change of a pixel's weights: data keep the gain of the recorded track."""
    if not plan.radar.antenna.directive:
        return 0.0
    recorded = direction_gain(plan.radar, slice(None), direction)
    line = point - plan.straight.track.position
    there = direction_gain(plan.straight, slice(None), unit_rows(line))
    there = np.interp(plan.x, plan.uniform, there)
    exact, taken = recorded**2 / np.sum(recorded**2), recorded * there / np.sum(there**2)
    return float(np.sum((taken - exact) ** 2) / np.sum(exact**2))


class MotionCompensation(LinearMap):
    r"""Linear map from range-compressed data of the recorded track to data of the straight line.

    Two steps in range, then the pulses are resampled to uniform positions along the line:

    1. the reference's excess range :math:`\Delta R_t` by a phase ramp over the band,
       :math:`e^{j (k_c + \kappa) \Delta R_t}`, which removes the reference's history for the third step;
    2. the difference :math:`\Delta R_t(r) - \Delta R_t` of every range r, in phase and in place;
    3. resampling from the recorded to uniform places, after which the line's range history is restored.

    Resampling is a type-2 non-uniform FFT with the gridding kernel of width 8 at twice the rate.

    Parameters
    ----------
    plan : from :func:`plan_straightening`

    Notes
    -----
    Formulas: A. Moreira, Y. Huang, IEEE Trans. Geosci. Remote Sens. 32 (1994), 1029; G. Fornaro, IEEE Trans. Aerosp.
    Electron. Syst. 35 (1999), 997. Ignores the variation of the excess range over the beam, which
    :func:`compensation_residual` gives, and with terrain off the image plane, and the change of :math:`R^{-2}` and of
    the beam's gain by the displacement.
    """

    def __init__(self, plan: Straightening) -> None:
        self.plan = plan
        radar, window = plan.radar, plan.radar.window
        self.kc = 4.0 * np.pi / radar.waveform.wavelength
        self.history = plan.reference_history(plan.x)
        center = float(np.linalg.norm(plan.aim)) if plan.sine is None else _middle_range(plan)
        at = self.history if plan.sine is None else np.full(self.history.shape, center)
        self.first = plan.excess(at[:, None])[:, 0]
        self.walk = self.first + self.history

        # u is the range from the reference's; sample 0 of pulse t is at u = start - walk
        self.start = window.start_range - self.walk
        self.u0, self.spacing = float(self.start.min()), window.sample_spacing
        self.n_samples = window.n_samples
        self.n_out = window.n_samples + int(np.ceil(np.ptp(self.start) / self.spacing))
        self.n_fft = int(scipy.fft.next_fast_len(self.n_out + _GUARD))
        self.kappa = 2.0 * np.pi * scipy.fft.fftfreq(self.n_fft, self.spacing)

        place = plan.place
        self.place = place if np.abs(place - np.arange(place.size)).max() > 1e-6 else None
        straight_walk = plan.reference_history(plan.uniform)
        self.back = np.exp(-1j * np.mod(self.kc * straight_walk, 2.0 * np.pi)).astype(np.complex64)
        receive = ReceiveWindow(self.u0 + straight_walk, self.spacing, self.n_out)
        self.radar = replace(plan.straight, window=receive)
        """The radar on the line; its receive window follows the reference."""

    def _parts(self) -> Iterator[slice]:
        """Pulses of each batch."""
        step = max(1, _BATCH // self.n_fft)
        for begin in range(0, self.plan.x.size, step):
            yield slice(begin, begin + step)

    def _shift(self, part: slice) -> C128:
        """Phase ramp over the band (n, n_fft) of some pulses."""
        return np.exp(-1j * np.outer(self.start[part] - self.u0, self.kappa))

    def _excess(self, part: slice) -> tuple[F64, C128]:
        """Places (n, n_out), samples, at which some pulses are read, and their phasors."""
        u = self.u0 + self.spacing * np.arange(self.n_out)
        delta = _rows(self.plan, part).excess(u + self.history[part, None]) - self.first[part, None]
        turn = np.exp(1j * np.mod(self.kc * (self.walk[part, None] + delta), 2.0 * np.pi))
        return (u - self.u0 + delta) / self.spacing, turn

    def forward(self, values: C64) -> C64:
        """Data (n_layers, n_pulses, n_out) on the line."""
        data = np.empty((len(values), self.back.size, self.n_out), dtype=np.complex64)
        for layer, pulses in enumerate(values):
            moved = np.empty((self.plan.x.size, self.n_out), dtype=np.complex64)
            for part in self._parts():
                spectrum = scipy.fft.fft(pulses[part], n=self.n_fft, axis=1, workers=-1)
                spectrum *= self._shift(part)
                place, turn = self._excess(part)
                moved[part] = _sample(spectrum, place) * turn
            if self.place is not None:
                moved = _interpolate_pulses(moved, self.place)
            data[layer] = moved * self.back[:, None]
        return data

    def adjoint(self, values: C64) -> C64:
        """Data (n_layers, n_pulses, n_samples) of the recorded track."""
        data = np.empty((len(values), self.plan.x.size, self.n_samples), dtype=np.complex64)
        for layer, pulses in enumerate(values):
            moved = pulses * self.back[:, None].conj()
            if self.place is not None:
                moved = _adjoint_along(moved, self.place)
            for part in self._parts():
                place, turn = self._excess(part)
                spectrum = _adjoint_sample(moved[part] * turn.conj(), place, self.n_fft)
                ramped = spectrum * self._shift(part).conj()
                line = scipy.fft.ifft(ramped, axis=1, workers=-1, norm="forward")
                data[layer, part] = line[:, : self.n_samples]
        return data


def compensate_motion(raw: RawData, plan: Straightening) -> RawData:
    """Range-compressed data converted to the straight line, see :class:`MotionCompensation`."""
    if raw.domain != "compressed":
        raise DataError("motion compensation: the data are not range compressed; call range_compress first")
    compensation = MotionCompensation(plan)
    return replace(raw, data=compensation.forward(raw.data), radar=compensation.radar)


def _middle_range(plan: Straightening) -> float:
    """Range of the image's middle along the beam, for a sweeping beam, m."""
    sine = float(plan.sine or 0.0)
    return float(np.hypot(plan.aim[1], plan.aim[2]) / np.sqrt(1.0 - sine**2))


def _rows(plan: Straightening, part: slice) -> Straightening:
    """The plan for selected pulses."""
    track = plan.radar.track
    kept = track.of_pulses(part)
    return replace(plan, radar=replace(plan.radar, track=kept), x=plan.x[part])


def _sample(spectrum: NDArray[np.complexfloating], place: F64) -> C64:
    """Values of periodic band-limited rows at fractional places.

    Parameters
    ----------
    spectrum : (rows, n) in FFT order
    place : (rows, m) float64, samples

    Returns
    -------
    (rows, m) complex64
    """
    rows, n = spectrum.shape
    half = n // 2
    padded = np.zeros((rows, 2 * n), dtype=np.complex64)
    gain = _gain(n)
    padded[:, : n - half] = spectrum[:, : n - half] * gain[: n - half]
    padded[:, 2 * n - half :] = spectrum[:, n - half :] * gain[n - half :]
    fine = scipy.fft.ifft(padded, axis=1, workers=-1)
    out = np.zeros(place.shape, dtype=np.complex64)
    for index, tap in _read_from(place, n):
        out += fine.ravel()[index] * tap
    return out


def _gain(n: int) -> F64:
    """Gain (n,) of the transform to twice the rate, with the kernel's transform divided out."""
    return np.asarray(2.0 / gridding_kernel(_WIDTH).transform(scipy.fft.fftfreq(n) / 2.0))


def _read_from(place: F64, n: int) -> Iterator[tuple[I64, F32]]:
    """Flat index and weight (rows, m) of each of the kernel's taps on rows of 2 n samples at twice the rate."""
    kernel = gridding_kernel(_WIDTH)
    at = 2.0 * place
    base = np.floor(at)
    index = base.astype(np.int64) - kernel.lead
    offset = np.arange(place.shape[0])[:, None] * (2 * n)
    for k, tap in enumerate(kernel.taps(at - base)):
        yield offset + (index + k) % (2 * n), tap.astype(np.float32)


def _adjoint_sample(values: NDArray[np.complexfloating], place: F64, n: int) -> C64:
    """Adjoint of :func:`_sample`: spectra (rows, n) from values (rows, m)."""
    rows, half = values.shape[0], n // 2
    fine = np.zeros(rows * 2 * n, dtype=np.complex128)
    for index, tap in _read_from(place, n):
        weighted = (values * tap).ravel()
        fine.real += np.bincount(index.ravel(), weighted.real, minlength=fine.size)
        fine.imag += np.bincount(index.ravel(), weighted.imag, minlength=fine.size)
    padded = scipy.fft.fft(fine.reshape(rows, 2 * n).astype(np.complex64), axis=1, workers=-1, norm="forward")
    spectrum = np.concatenate([padded[:, : n - half], padded[:, 2 * n - half :]], axis=1)
    return np.asarray(spectrum * _gain(n), dtype=np.complex64)


def _interpolate_pulses(data: C64, place: F64) -> C64:
    """Pulses at fractional places, (n_pulses, n) complex64."""
    n = int(scipy.fft.next_fast_len(data.shape[0] + 2 * _GUARD))
    out = np.empty_like(data)
    step = max(1, _BATCH // n)
    for begin in range(0, data.shape[1], step):
        columns = np.ascontiguousarray(data[:, begin : begin + step].T)
        spectrum = scipy.fft.fft(columns, n=n, axis=1, workers=-1)
        out[:, begin : begin + step] = _sample(
            spectrum, np.broadcast_to(place, (columns.shape[0], place.size))
        ).T
    return out


def _adjoint_along(data: C64, place: F64) -> C64:
    """Adjoint of :func:`_interpolate_pulses`."""
    n = int(scipy.fft.next_fast_len(data.shape[0] + 2 * _GUARD))
    out = np.empty_like(data)
    step = max(1, _BATCH // n)
    for begin in range(0, data.shape[1], step):
        columns = np.ascontiguousarray(data[:, begin : begin + step].T)
        at = np.broadcast_to(place, (columns.shape[0], place.size))
        line = scipy.fft.ifft(_adjoint_sample(columns, at, n), axis=1, workers=-1, norm="forward")
        out[:, begin : begin + step] = line[:, : data.shape[0]].T
    return out


def needs_compensation(
    focuser: Focuser, radar: Radar, grid: ImageGrid, option: str
) -> tuple[Straightening, Residual] | None:
    """Motion compensation that a focuser needs for a radar's data, and its residual; None where none is needed.

    ``auto`` compensates where the focuser refuses the recorded track and accepts the straight one.

    Raises
    ------
    DataError
        Unknown option, or compensation does not remove the focuser's refusal.
    """
    if option not in MOTION_COMPENSATIONS:
        raise DataError(
            f"motion compensation {option!r}: unknown{did_you_mean(option, MOTION_COMPENSATIONS)}; choose one of "
            f"{', '.join(MOTION_COMPENSATIONS)}"
        )
    if not focuser.objection(radar, grid):
        return None
    if option == "off" or radar.track.is_straight or radar.receiver is not None or lit_from_orbit(radar):
        check_focuser(focuser, radar, grid)
    try:
        plan = plan_straightening(radar, grid)
    except DataError as error:
        raise DataError(
            f"focuser {focuser.name}: motion compensation: {error}; take focuser backprojection"
        ) from None
    if turns(plan.straight):
        raise DataError(
            f"focuser {focuser.name}: motion compensation: the beam turns over a curved track; take focuser "
            "backprojection"
        )
    check_focuser(focuser, plan.straight, grid)
    residual = compensation_residual(plan, grid)
    if residual.phase > LARGEST_RESIDUAL:
        raise DataError(
            f"focuser {focuser.name}: motion compensation over {plan.largest_displacement:.3g} m leaves "
            f"{residual.phase:.3g} rad at the image's edges (bound {LARGEST_RESIDUAL:.2g} rad), because the excess "
            "range varies over the beam; shrink the image or take focuser backprojection"
        )
    return plan, residual
