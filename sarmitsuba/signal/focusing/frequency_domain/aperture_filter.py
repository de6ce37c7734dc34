"""Spectrum of backprojection's pulse weights over a pixel's aperture."""

from dataclasses import dataclass

import numpy as np
from scipy.special import fresnel

from sarmitsuba.core.arrays import C64, F64
from sarmitsuba.radar.radar import Radar
from sarmitsuba.signal.focusing.frequency_domain.track_geometry import (
    TrackGeometry,
    boresight_sine,
    lit_in_turn,
    own_apertures,
)
from sarmitsuba.signal.focusing.frequency_domain.weights import filter_gain
from sarmitsuba.signal.focusing.windows import Window
from sarmitsuba.signal.gridding import unit_phasor
from sarmitsuba.signal.image import ImageGrid

# nodes of the weight over the aperture's sines, linear between them
_NODES = 4097
# largest argument of the tabulated tails of the aperture's ends (without phase), and nodes per unit; beyond, they fall
# as the inverse argument
_FAR, _FINE = 32.0, 64
# time-bandwidth product of the aperture up to which higher orders are added; beyond, they are below -70 dB
_FEW = 100.0
# half of the tabulated band over half the aperture, and the transform's period over that band
_WIDE, _PERIOD = 4, 4
# largest sine that an aperture reaches
_STEEPEST = 0.999


@dataclass(frozen=True, eq=False)
class _ApertureEnd:
    """One end of the aperture.

    Parameters
    ----------
    sine : where it is
    sign : 1 where the aperture lies at lesser sines, else -1
    tail : (2 n,) complex64 at arguments 0 ... _FAR outside of the aperture, then inside, without the phase
    spacing : m between pulses, over which the aperture ends
    """

    sine: float
    sign: float
    tail: C64
    spacing: float

    @staticmethod
    def of(sine: float, sign: float, level: complex, slope: complex, spacing: float) -> "_ApertureEnd":
        """Where the weight has this level, and this slope outwards per unit of the argument."""
        v = np.arange(0.0, _FAR + 0.5 / _FINE, 1.0 / _FINE)
        s, c = fresnel(v)
        tail = (0.5 - (c + 1j * s) / (1.0 + 1j)) * np.exp(-0.5j * np.pi * v**2)
        kink = 1j / (np.pi * (1.0 + 1j))
        outside = (level + slope * v) * tail - slope * kink
        inside = (slope * v - level) * tail - slope * kink
        return _ApertureEnd(sine, sign, np.concatenate([outside, inside]).astype(np.complex64), spacing)

    def add(self, out: C64, kx: F64, k: F64, ky: F64, rho: float) -> None:
        """Add the end's tail at wavenumbers to ``out``."""
        cosine = np.sqrt(1.0 - self.sine**2)
        # of the filter at the end against the place of stationary phase
        phase = (k * (1.0 / cosine) - kx * (self.sine / cosine) - ky) * rho
        far = np.sqrt(np.maximum(phase, 0.0) * (2.0 / np.pi * _FINE**2))
        place = np.minimum(far, _FAR * _FINE - 0.01)
        scale = (place / np.maximum(far, 1.0)).astype(np.float32)
        scale[far < _FAR * _FINE - 0.01] = 1.0
        place += (self.tail.size // 2) * (self.sign * (self.sine * k - kx) > 0.0)
        node = place.astype(np.int32)
        value = self.tail[node]
        value += (place - node).astype(np.float32) * (self.tail[node + 1] - value)
        scale *= np.sinc(((kx - self.sine * k) * (0.5 / np.pi * self.spacing)).astype(np.float32))
        value *= scale
        value *= self._level(kx / k, ky / k).astype(np.float32)
        value *= unit_phasor(phase)
        out += value

    def _level(self, sine: F64, cosine: F64) -> F64:
        r"""Amplitude of the end's pulse over that of the pulse of stationary phase, whose tail is taken, at sines.

        .. math:: \sqrt{\frac{2}{c_e (1 - s s_e + c c_e)}} \, \frac{c^{7/2}}{c_e^2}

        for cosines c and :math:`c_e`: the end's integral by parts over the tail far from it, 1 at the end. Without it
        the tail grows as :math:`c^{-7/2}` towards grazing, where no pulse of the aperture looks.
        """
        edge = np.sqrt(1.0 - self.sine**2)
        near = edge * np.maximum(1.0 - sine * self.sine + edge * cosine, edge**2)
        return np.asarray(np.sqrt(2.0 / near) * cosine**3.5 / edge**2)


@dataclass(frozen=True, eq=False)
class _SineTable:
    """Values at equidistant sines, linear between them and zero beyond."""

    first: float
    step: float
    value: C64

    def add(self, out: C64, sine: F64) -> None:
        """Add the values at sines to ``out``."""
        place = (sine - self.first) * (1.0 / self.step)
        place = np.clip(place, 0.0, self.value.size - 1.001)
        node = place.astype(np.int32)
        low = self.value[node]
        out += low + (place - node).astype(np.float32) * (self.value[node + 1] - low)


def _higher_orders(
    weight: F64, bend: F64, slopes: tuple[float, float], sines: F64, spread: float
) -> _SineTable:
    r"""Higher orders of a short aperture's spectrum: :math:`e^{j D \partial^2 / 2} w` minus the stationary-phase law.

    The ends' straight line has the law's tails exactly; the rest vanishes at the ends and is transformed numerically,
    and the law's tail of its slope there is taken off.

    Parameters
    ----------
    weight, bend : (n,) float64 at ``sines``, w and w''
    slopes : of the weight at both ends, outwards
    sines : (n,) equidistant, over the aperture
    spread : D, :math:`\cos^3\theta / k \rho` in the aperture's middle
    """
    n, step = sines.size, float(sines[1] - sines[0])
    line = (weight[-1] - weight[0]) / (sines[-1] - sines[0])
    rest = weight - weight[0] - line * (sines - sines[0])
    beside = (_WIDE - 1) * (n - 1) // 2
    size = _WIDE * _PERIOD * (n - 1)
    padded = np.zeros(size, dtype=np.complex128)
    padded[beside : beside + n] = rest
    kappa = 2.0 * np.pi * np.fft.fftfreq(size, step)
    spectrum = np.fft.fft(padded) * np.exp(-0.5j * spread * kappa**2)
    # values outside the period would be aliased
    spectrum[np.abs(spread * kappa) > 0.5 * size * step] = 0.0
    value = np.fft.ifft(spectrum)[: n + 2 * beside]
    value[beside : beside + n] -= rest + 0.5j * spread * bend
    place = sines[0] + step * (np.arange(value.size) - beside)
    unit = np.sqrt(np.pi * spread)
    for end, sign, slope in ((sines[0], -1.0, slopes[0] + line), (sines[-1], 1.0, slopes[1] - line)):
        beyond = sign * (place - end) / unit
        v = np.abs(beyond)
        s, c = fresnel(v)
        tail = 0.5 - (c + 1j * s) / (1.0 + 1j)
        kink = 1j / (np.pi * (1.0 + 1j)) * np.exp(0.5j * np.pi * v**2)
        value -= slope * unit * (v * tail - kink)
    value[[0, -1]] = 0.0
    return _SineTable(float(place[0]), step, value.astype(np.complex64))


@dataclass(frozen=True, eq=False)
class ApertureFilter:
    r"""Spectrum of a pixel's pulse weights, without that of the azimuth chirp, by stationary phase to second order.

    Backprojection weighs a pulse by the direction of the pixel, w(s) = window times pattern for the sine s of its
    angle: a filter over the track, for a wavenumber k and a range :math:`\rho`, whose spectrum at
    :math:`k_x = k \sin\theta` is

    .. math:: H = w + \frac{j \cos^3\theta}{2 k \rho} w'' \quad \text{within the aperture}

    and at its ends, where the weight stops at a level a and a slope b, the tail

    .. math:: \mp \frac{1}{1 + j} \int_{\pm v}^\infty (a + b (t - v)) e^{j \pi t^2 / 2} dt, \quad
              \frac{\pi v^2}{2} = \rho \left(\frac{k - k_x s_e}{\sqrt{1 - s_e^2}} - k_y\right)

    (uniform in the distance v from the end; upper sign inside), times :math:`\mathrm{sinc}((k_x - k s_e) \Delta x / 2)`
    as the weight ends within one pulse, not abruptly, see
    :func:`sarmitsuba.signal.focusing.aperture_weights.band_weights`. Without the tails a frequency-domain focuser cuts
    the aperture by the echo's Doppler frequency, not by the pixel's angle, and its side lobes have another phase.

    Parameters
    ----------
    sines : (n,) float64, equidistant
    weight : (n,) complex64, H within the aperture at these
    ends : of the aperture, none where all pulses serve all pixels
    rho : m, range of closest approach
    higher : higher orders for apertures of a small time-bandwidth product; at k_c

    Notes
    -----
    Ignores the change of the tails and of w'' with the range within the swath.
    """

    sines: F64
    weight: C64
    ends: tuple[_ApertureEnd, ...]
    rho: float
    higher: _SineTable | None = None

    def __call__(self, kx: F64, k: F64, ky: F64) -> C64:
        """H (rows, count) at kx (rows, 1), k (count,) and ky (rows, count), rad/m."""
        sine = kx / k
        step = self.sines[1] - self.sines[0]
        place = np.clip((sine - self.sines[0]) * (1.0 / step), 0.0, self.sines.size - 1.001)
        node = place.astype(np.int32)
        low = self.weight[node]
        out = low + (place - node).astype(np.float32) * (self.weight[node + 1] - low)
        for end in self.ends:
            out[end.sign * (end.sine - sine) <= 0.0] = 0.0
        for end in self.ends:
            end.add(out, kx, k, ky, self.rho)
        if self.higher is not None:
            self.higher.add(out, sine)
        return np.asarray(out)


def aperture_filter(
    radar: Radar, grid: ImageGrid, geometry: TrackGeometry, window: Window, sines: F64
) -> ApertureFilter | None:
    """Filter of a slant grid's pixels over a range of sines (2,); None where it is 1 throughout."""
    own = own_apertures(radar)
    if not lit_in_turn(radar):
        return None
    middle, half = boresight_sine(radar), radar.half_aperture
    bounds = np.clip(middle + half * np.array([-1.0, 1.0]) if own else sines, -_STEEPEST, _STEEPEST)
    nodes = np.linspace(bounds[0], bounds[1], _NODES)
    weight = filter_gain(radar, grid, nodes)
    if own:
        weight = weight * window(np.clip((nodes - middle) / (2.0 * half), -0.5, 0.5))
    k, rho = 4.0 * np.pi / radar.waveform.wavelength, geometry.rho_center
    slope = np.gradient(weight, nodes, edge_order=2)
    bend = np.gradient(slope, nodes, edge_order=2)
    ends = []
    for index, sign in ((0, -1.0), (-1, 1.0)) if own else ():
        # sine per unit of v
        unit = (1.0 - nodes[index] ** 2) ** 0.75 * np.sqrt(np.pi / (k * rho))
        level, outwards = weight[index], sign * slope[index] * unit
        ends.append(_ApertureEnd.of(float(nodes[index]), sign, level, outwards, geometry.spacing))
    full = weight + 0.5j * bend * (1.0 - nodes**2) ** 1.5 / (k * rho)
    higher = None
    if own and 2.0 * half**2 * k * rho / np.pi < _FEW:
        spread = float((1.0 - middle**2) ** 1.5 / (k * rho))
        higher = _higher_orders(weight, bend, (-slope[0], slope[-1]), nodes, spread)
    return ApertureFilter(nodes, full.astype(np.complex64), tuple(ends), rho, higher)
