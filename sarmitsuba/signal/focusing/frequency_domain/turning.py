r"""Beams that turn over a track (TOPS, sliding spotlight), for focusers that take one Doppler band for all pixels.

Pixels are lit in turn, each at Doppler frequencies of its own; all of them together are wider than the PRF. Multiplied
by

.. math:: e^{-j k \Phi(x)}, \quad \Phi' = s_b(x),

the sine of the boresight (deramping), the echoes of every place lie within the beam about zero, and a pixel's aperture
is a filter that is the same for all: at the wavenumber :math:`k u` of a sine u off the boresight

.. math:: H(u) = \frac{\int w(u') g(u') e^{-j a x^2 / 2 - j k u x} dx}{\int e^{-j a x^2 / 2 - j k u x} dx}, \quad
          u' = -a x / k, \quad a = k \left(\frac{\cos^3\theta}{\rho} + s_b'\right)

with window and band w, the pattern g and the rate a of a point's phase. Filtered at positions closer by a whole factor
and multiplied by :math:`e^{j k \Phi}` (reramping), the echoes are those of an isotropic antenna on a dense track that
has seen every pixel in its aperture only. A track in orbit is first replaced by a straight one
(:mod:`sarmitsuba.signal.focusing.frequency_domain.equivalent_track`).
"""

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
import scipy.fft
import scipy.interpolate

from sarmitsuba.core.arrays import C64, F64
from sarmitsuba.radar.antenna import Antenna, Pointing
from sarmitsuba.radar.radar import Radar, ReceiveWindow
from sarmitsuba.radar.track import Track
from sarmitsuba.signal.focusing.aperture_weights import (
    aperture_weights,
    band_weights,
    direction_gain,
    look_directions,
)
from sarmitsuba.signal.focusing.frequency_domain.equivalent_track import EquivalentTrack, beam_sines, in_orbit
from sarmitsuba.signal.focusing.grid import slant_below
from sarmitsuba.signal.focusing.summed_weights import sum_at_nodes
from sarmitsuba.signal.focusing.windows import Window, parse_window
from sarmitsuba.signal.gridding import unit_phasor
from sarmitsuba.signal.image import ImageGrid
from sarmitsuba.signal.raw_data import RawData

# change of the boresight's sine over the track up to which a beam counts as fixed to it: rounding
_FIXED = 1e-9
# share of the raised PRF that sines may take
_FILL = 0.6
# samples of the filter's weight per closer pulse; pulses of zeros beside the track for each of its half length
_FINE, _GUARD = 4, 1.5
# power of the filter's change over range above which an image is divided, most parts, and their least columns
_CHANGE, _MOST_BLOCKS, _LEAST = 1e-6, 8, 16
# phase that an equivalent track leaves, likewise
_PHASE = 0.01
# widths of a chirp of a point's rate that the filter's band reaches beyond the aperture's ends, at least
_TAILS = 10.0
# nodes at which summed weights are computed at most
_MOST = 20_000


def turns(radar: Radar) -> bool:
    """Whether pixels are lit in turn by a beam that turns over the track, or from orbit."""
    lit = np.isfinite(radar.half_aperture) or (radar.antenna.directive and radar.mode_law.own_apertures)
    return bool(lit and (np.ptp(beam_sines(radar)) > _FIXED or in_orbit(radar)))


def lit_from_orbit(radar: Radar) -> bool:
    """Whether pixels are lit in turn from orbit."""
    return in_orbit(radar) and turns(radar)


@dataclass(frozen=True, eq=False)
class TurningBeam:
    """Deramping and reramping of a burst.

    Parameters
    ----------
    radar : as recorded, its beam turning
    grid : of the image, in slant range
    spacing : m between pulses
    factor : by which pulses come closer
    guard : pulses of zeros on either side
    half : half of a pixel's aperture, in sines off the boresight
    """

    radar: Radar
    grid: ImageGrid
    spacing: float
    factor: int
    guard: int
    half: float

    @staticmethod
    def of(radar: Radar, grid: ImageGrid) -> "TurningBeam":
        """Plan for a straight, uniformly sampled track and a slant or ground grid along it."""
        slant = slant_below(radar, grid) if grid.kind == "ground" else grid
        track = radar.track
        spacing = float(np.linalg.norm((track.position[-1] - track.position[0]) / (track.n_pulses - 1)))
        nyquist = radar.waveform.wavelength / (4.0 * spacing)
        half = min(radar.half_aperture, radar.antenna.nulls[0] if radar.antenna.directive else np.inf)
        sine = beam_sines(radar)
        x = (track.position - slant.origin) @ slant.along
        ahead = np.array([slant.azimuth[0] - x[-1], slant.azimuth[-1] - x[0]])[:, None]
        seen = np.abs(ahead / np.hypot(ahead, slant.range[[0, -1]])).max()
        beam = TurningBeam(radar, slant, spacing, 1, 0, half)
        widest = max(float(seen), float(np.abs(sine).max()) + beam.kept)
        beam = replace(beam, factor=int(np.ceil(widest / (_FILL * nyquist))))
        reach = half / (beam.rate(float(slant.range[0]), 0.0))
        return replace(beam, guard=int(np.ceil(_GUARD * reach / spacing)) + 32)

    @property
    def kept(self) -> float:
        """Half of the filter's band, in sines: that of the aperture and the tails of its ends."""
        k = 4.0 * np.pi / self.radar.waveform.wavelength
        width = np.sqrt(self.rate(float(self.grid.range[0]), 0.0) / k)
        return self.half + max(self.half, _TAILS * float(width))

    @property
    def turn(self) -> float:
        """Change of the boresight's sine per metre of track, in the middle."""
        sine = beam_sines(self.radar)
        return float(np.polyfit(self.spacing * np.arange(sine.size), sine, 1)[0])

    def rate(self, rho: float, sine: float) -> float:
        """Rate a over k of a point's phase at a closest range and a sine, 1/m."""
        return float((1.0 - sine**2) ** 1.5 / rho + self.turn)

    @property
    def dense(self) -> F64:
        """Positions of the closer pulses, in pulses of the track."""
        n = self.radar.track.n_pulses + 2 * self.guard
        return np.asarray(np.arange(n * self.factor) / self.factor - self.guard)

    def phase(self, place: F64) -> F64:
        """Phi, m, at positions counted in pulses; beyond the track the beam turns on."""
        sine = beam_sines(self.radar)
        sums = self.spacing * np.concatenate([[0.0], np.cumsum(0.5 * (sine[1:] + sine[:-1]))])
        curve = scipy.interpolate.CubicSpline(np.arange(sine.size), sums)
        inside = np.clip(place, 0.0, sine.size - 1.0)
        beyond = place - inside
        slope = np.where(beyond < 0.0, sine[0], sine[-1])
        return np.asarray(
            curve(inside) + self.spacing * beyond * (slope + 0.5 * self.spacing * beyond * self.turn)
        )

    @property
    def held_radar(self) -> Radar:
        """Isotropic radar on the dense track, whose pulses all serve all pixels."""
        radar, place = self.radar, self.dense
        track, index = radar.track, np.arange(radar.track.n_pulses)
        step = (track.position[-1] - track.position[0]) / (track.n_pulses - 1)
        interval = float(track.time[-1] - track.time[0]) / (track.n_pulses - 1)
        position = track.position[0] + place[:, None] * step
        velocity = np.broadcast_to(step / interval, position.shape).copy()
        nearest = np.clip(np.rint(place), 0, index.size - 1).astype(int)
        pointing = Pointing(
            radar.pointing.boresight[nearest],
            radar.pointing.azimuth_axis[nearest],
            radar.pointing.elevation_axis[nearest],
        )
        start, samples = self._window()
        return replace(
            radar,
            track=Track(track.time[0] + place * interval, position, velocity, track.epoch),
            pointing=pointing,
            antenna=Antenna(gain=radar.antenna.gain),
            half_aperture=np.inf,
            window=ReceiveWindow(np.full(place.size, start), radar.window.sample_spacing, samples),
        )

    def _window(self) -> tuple[float, int]:
        """First range and samples of a window that holds those of all pulses."""
        window = self.radar.window
        start = float(window.start_range.min())
        more = int(np.ceil(np.ptp(window.start_range) / window.sample_spacing))
        return start, int(scipy.fft.next_fast_len(window.n_samples + more))

    def gain(self, offset: F64) -> F64:
        """Two-way amplitude of the pattern at sines off the boresight in azimuth."""
        if not self.radar.antenna.directive:
            return np.ones_like(offset)
        return np.asarray(self.radar.antenna.two_way_amplitude(offset, np.zeros_like(offset)))

    def filter(self, k: F64, n: int, window: Window, *, rate: float | None = None) -> C64:
        """H (n, count) at the wavenumbers of an n-point transform over the closer pulses, for k (count,), rad/m.

        ``rate`` : a over k, 1/m; default: that of the image's middle
        """
        rate = rate or self.rate(float(self.grid.range[self.grid.range.size // 2]), 0.0)
        step = self.spacing / self.factor
        m, own = _FINE * n, np.isfinite(self.radar.half_aperture)
        x = (np.arange(m) - m // 2) * (step / _FINE)
        offset: F64 = np.asarray(-rate * x, dtype=np.float64)
        weight = self.gain(np.clip(offset, -1.0, 1.0))
        if own:
            weight = weight * band_weights(offset, rate * self.spacing, self.radar.half_aperture, window)
        else:
            weight = np.where(np.abs(offset) <= self.half, weight, 0.0)
        wavenumber = 2.0 * np.pi * scipy.fft.fftfreq(n, step)
        used = np.flatnonzero(weight)
        pick = np.concatenate([np.arange((n + 1) // 2), np.arange(m - n // 2, m)])
        out = np.empty((n, k.size), dtype=np.complex64)
        for i, each in enumerate(k):
            a = each * rate
            line = np.zeros(m, dtype=np.complex128)
            line[(used - m // 2) % m] = weight[used] * np.exp(-0.5j * a * x[used] ** 2)
            spectrum = scipy.fft.fft(line)[pick] * (step / _FINE)
            spectrum[np.abs(wavenumber) > self.kept * each] = 0.0
            out[:, i] = spectrum * np.exp(-0.5j * wavenumber**2 / a) / np.sqrt(2.0 * np.pi / (1j * a))
        return out

    def unfold(self, raw: RawData, window: Window) -> RawData:
        """Echoes of the isotropic radar on the dense track, each pixel in its own aperture.

        Parameters
        ----------
        raw : range-compressed
        window : over the aperture of a pixel, or over the pulses where all serve it
        """
        radar, place = self.radar, self.dense
        n, pulses = place.size // self.factor, radar.track.n_pulses
        start, samples = self._window()
        kappa = 2.0 * np.pi * scipy.fft.fftfreq(samples, radar.window.sample_spacing)
        k = 4.0 * np.pi / radar.waveform.wavelength + kappa
        late = radar.window.start_range - start
        weights = np.ones(pulses)
        if np.isinf(radar.half_aperture):
            weights = window.aperture(pulses)
        phase = self.phase(place)
        out = np.empty((len(raw.data), place.size, samples), dtype=np.complex64)
        for layer, data in enumerate(raw.data):
            spectrum = scipy.fft.fft(data * weights[:, None].astype(np.float32), n=samples, axis=1)
            spectrum *= unit_phasor(-np.outer(late, kappa))
            dense = np.empty((place.size, samples), dtype=np.complex64)
            for first in range(0, samples, 32):
                some = slice(first, first + 32)
                ramp = unit_phasor(np.outer(phase, k[some]))
                line = np.zeros((n, ramp.shape[1]), dtype=np.complex64)
                line[self.guard : self.guard + pulses] = spectrum[:, some]
                line = scipy.fft.fft(line * ramp[:: self.factor].conj(), axis=0)
                # pulses with zeros between them: their spectrum comes again
                wide = np.tile(line, (self.factor, 1))
                wide *= self.filter(k[some], place.size, window).conj()
                dense[:, some] = scipy.fft.ifft(wide, axis=0) * ramp
            out[layer] = scipy.fft.ifft(dense, axis=1) * np.float32(self.factor)
        return replace(raw, data=out, radar=self.held_radar)

    def pulse_weights(self, point: F64, window: Window) -> F64:
        """Weight w g g_filter of every pulse in the pixels at points (..., 3), (..., n_pulses)."""
        radar = self.radar
        look = look_directions(radar, point)
        forward = radar.track.velocity / np.linalg.norm(radar.track.velocity, axis=1)[:, None]
        offset = np.sum(look * forward, axis=-1) - beam_sines(radar)
        gain = direction_gain(radar, slice(None), look) * self.gain(np.clip(offset, -1.0, 1.0))
        if np.isinf(radar.half_aperture):
            gain = np.where(np.abs(offset) <= self.half, gain, 0.0)
        return np.asarray(aperture_weights(radar, point, window) * gain)

    def scale(self, grid: ImageGrid, window: Window) -> F64:
        """Inverse sum of the pulses' weights, (n_azimuth, n_range); zero outside of the beam."""

        def sums(nodes: ImageGrid) -> F64:
            return np.array([self.pulse_weights(line, window).sum(axis=-1) for line in nodes.positions()])

        total = sum_at_nodes(grid, sums, most=_MOST).at(grid).astype(np.float64)
        return np.divide(1.0, total, out=np.zeros(grid.shape), where=total > 1e-6 * total.max())

    def change_power(self, *, azimuth: bool = True) -> float:
        """Relative power of the change of the filter from the image's middle to its edges, which is ignored.

        ``azimuth`` : also from the middle of the track to its ends
        """
        k = np.array([4.0 * np.pi / self.radar.waveform.wavelength])
        n, window = self.dense.size, parse_window("rectangular")
        exact = self.filter(k, n, window)
        steepest = float(np.abs(beam_sines(self.radar)).max()) * azimuth
        worst = 0.0
        for rho in self.grid.range[[0, -1]]:
            for sine in {0.0, steepest}:
                other = self.filter(k, n, window, rate=self.rate(float(rho), sine))
                worst = max(worst, float(np.sum(np.abs(other - exact) ** 2) / np.sum(np.abs(exact) ** 2)))
        return worst


def range_blocks(radar: Radar, grid: ImageGrid) -> list[ImageGrid]:
    """Parts of an image over range within which the filter hardly changes; at most eight."""
    count = 1
    while count < _MOST_BLOCKS and grid.range.size >= 2 * _LEAST * count:
        first = replace(grid, range=np.array_split(grid.range, count)[0])
        left = 0.0 if radar.track.is_straight else EquivalentTrack.of(radar, first).phase
        if left <= _PHASE and TurningBeam.of(radar, first).change_power(azimuth=False) <= _CHANGE:
            break
        count *= 2
    return [replace(grid, range=part) for part in np.array_split(grid.range, count)]


@lru_cache(maxsize=8)
def hold_beam(radar: Radar, grid: ImageGrid) -> tuple[Radar, ImageGrid]:
    """Radar and slant grid themselves, or, where the beam turns, those that `TurningBeam` makes of them."""
    if not turns(radar):
        return radar, grid
    if not radar.track.is_straight:
        track = EquivalentTrack.of(radar, grid)
        radar, grid = track.straight, track.straight_grid
    return TurningBeam.of(radar, grid).held_radar, grid
