"""Compiled inner loops of backprojection, a sum over pulses for every pixel, and of its adjoint (Dr.Jit, LLVM or CUDA).

The adjoint adds every pixel's value to the profiles of all pulses. Pixels that share a lane share a pulse's line of
sight. Complex numbers are pairs of arrays.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from types import ModuleType
from typing import TYPE_CHECKING

import numpy as np

from sarmitsuba.machine.backend import device_numbers, dr
from sarmitsuba.radar.antenna import Antenna
from sarmitsuba.signal.gridding import GriddingKernel

if TYPE_CHECKING:
    Complex = tuple[dr.ArrayBase, dr.ArrayBase]


TWO_PI = 6.283185307179586


def cis(types: ModuleType, turns: dr.ArrayBase) -> Complex:
    """Cosine and sine of float64 turns, which are reduced before they are rounded to float32."""
    sin, cos = dr.sincos(types.Float32(turns - dr.round(turns)) * TWO_PI)
    return cos, sin


def times(a: Complex, b: Complex) -> Complex:
    """Product of complex numbers."""
    return dr.fma(a[0], b[0], -(a[1] * b[1])), dr.fma(a[0], b[1], a[1] * b[0])


def scale_complex(factor: dr.ArrayBase, a: Complex) -> Complex:
    """A complex number times a real one."""
    return factor * a[0], factor * a[1]


def weighted_sum(weights: Sequence[float], values: list[Complex]) -> Complex:
    """Sum of complex numbers, weighted with literals; zero where there are none."""
    re, im = 0.0, 0.0
    for weight, value in zip(weights, values, strict=True):
        re, im = dr.fma(weight, value[0], re), dr.fma(weight, value[1], im)
    return re, im


@dataclass(frozen=True)
class Scales:
    """Numbers of the geometry, float64 opaque.

    Parameters
    ----------
    per_metre : profile samples per m of slant range
    turns_per_metre : turns of the carrier's phase per m of slant range, 2 fc / c
    inverse_square : 1 / R_0^2, 1 / m^2
    """

    per_metre: dr.ArrayBase
    turns_per_metre: dr.ArrayBase
    inverse_square: dr.ArrayBase


@dataclass(frozen=True)
class LanePixels:
    """Equally spaced pixels of one lane, whose ranges and echoes are expanded about a few of them.

    Parameters
    ----------
    n_pixels : in the lane; the range is expanded about pixel ``n_pixels // 2``
    n_nodes : places where the profiles are interpolated; the pixels' values follow by the polynomial through them
        (directly, where there are as many nodes as pixels)
    step : from one pixel to the next, x, y, z, m, float64 opaque
    checked : whether a pixel may lie outside the receive window; else no sample is tested
    """

    n_pixels: int
    n_nodes: int
    step: tuple[dr.ArrayBase, dr.ArrayBase, dr.ArrayBase]
    checked: bool

    @property
    def places(self) -> list[int]:
        """Places of the pixels from the middle one, in steps."""
        return list(range(-(self.n_pixels // 2), self.n_pixels - self.n_pixels // 2))

    @property
    def bends(self) -> tuple[int, ...]:
        """Places where the weights are evaluated, between which they are parabolas."""
        return (0,) if self.n_pixels == 1 else (0, -(self.n_pixels // 2), self.n_pixels // 2)

    @property
    def direct(self) -> bool:
        """Whether the profiles are interpolated at every pixel."""
        return self.n_nodes >= self.n_pixels

    @property
    def nodes(self) -> tuple[float, ...]:
        """Places where the profiles are interpolated: Chebyshev's points."""
        if self.direct:
            return tuple(float(place) for place in self.places)
        return _chebyshev_points(self.n_pixels, self.n_nodes)

    def mix(self, place: int) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """Weights of the sums and of the differences of opposite nodes in the polynomial's value at a place.

        Nodes j and k - 1 - j are opposite; a middle one counts as a sum. Places m and -m take the same weights, the
        differences' with the other sign.
        """
        return _polynomial_weights(self.nodes, place)


@lru_cache(maxsize=64)
def _chebyshev_points(n_pixels: int, n_nodes: int) -> tuple[float, ...]:
    """Chebyshev's points over a line of pixels, in steps from its middle."""
    x = np.cos(np.pi * (np.arange(n_nodes) + 0.5) / n_nodes)
    return tuple(float(v) for v in 0.5 * n_pixels * x)


@lru_cache(maxsize=1024)
def _polynomial_weights(places: tuple[float, ...], place: int) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Weights of :meth:`LanePixels.mix` of the polynomial through values at ``places``."""
    nodes, k = np.array(places), len(places)
    lagrange = [
        float(np.prod((place - np.delete(nodes, j)) / (nodes[j] - np.delete(nodes, j)))) for j in range(k)
    ]
    even = [0.5 * (lagrange[j] + lagrange[k - 1 - j]) for j in range((k + 1) // 2)]
    odd = [0.5 * (lagrange[j] - lagrange[k - 1 - j]) for j in range(k // 2)]
    if k % 2:
        even[-1] = lagrange[k // 2]
    return tuple(even), tuple(odd)


@dataclass(frozen=True)
class Sight:
    """One pulse's line of sight to the middle of every lane's pixels.

    Parameters
    ----------
    line : pixels of the lane
    delta : x, y, z from antenna to pixel, float64, m
    square, distance, inverse : of its length, float64
    slope : m of range per pixel, float64
    bend : m of range per pixel squared, float32
    """

    line: LanePixels
    delta: tuple[dr.ArrayBase, dr.ArrayBase, dr.ArrayBase]
    square: dr.ArrayBase
    distance: dr.ArrayBase
    inverse: dr.ArrayBase
    slope: dr.ArrayBase
    bend: dr.ArrayBase

    @classmethod
    def of(cls, types: ModuleType, line: LanePixels, delta: tuple[dr.ArrayBase, ...]) -> Sight:
        """Range and its expansion."""
        dx, dy, dz = delta
        sx, sy, sz = line.step
        square = dr.fma(dx, dx, dr.fma(dy, dy, dz * dz))
        distance = dr.sqrt(square)
        inverse = dr.rcp(distance)
        slope = dr.fma(dx, sx, dr.fma(dy, sy, dz * sz)) * inverse
        step = dr.fma(sx, sx, dr.fma(sy, sy, sz * sz))
        bend = types.Float32(0.5 * dr.fma(-slope, slope, step) * inverse)
        return cls(line, (dx, dy, dz), square, distance, inverse, slope, bend)

    def received_at(self, other: Sight) -> Sight:
        """Bistatic slant range, half the path over the pixel to the receiver, and product of both ranges."""
        assert self.line.n_pixels == 1
        square, distance = self.distance * other.distance, 0.5 * (self.distance + other.distance)
        return replace(self, square=square, distance=distance)

    def direction(self, types: ModuleType, place: int) -> tuple[dr.ArrayBase, ...]:
        """Unit vector, float32, to the pixel ``place`` steps from the middle one."""
        d = [
            types.Float32(dr.fma(float(place), s, v)) for v, s in zip(self.delta, self.line.step, strict=True)
        ]
        scale = dr.rsqrt(dr.fma(d[0], d[0], dr.fma(d[1], d[1], d[2] * d[2])))
        return tuple(v * scale for v in d)

    def middle_phasor(self, types: ModuleType, scales: Scales, weight: dr.ArrayBase) -> Complex:
        r""":math:`w (R^2 / R_0^2) e^{+j 4 \pi f_c R / c}` of the middle pixel."""
        gain = weight * types.Float32(self.square * scales.inverse_square)
        return scale_complex(gain, cis(types, self.distance * scales.turns_per_metre))

    def bends(self, types: ModuleType, scales: Scales) -> list[Complex]:
        """Ratio of a node's phasor to the middle pixel's, without the phase linear in the place."""
        Float = types.Float32
        tilt = Float(2.0 * self.slope * self.inverse)
        curve = dr.fma(2.0 * self.bend, Float(self.inverse), 0.25 * tilt * tilt)
        turns = self.bend * Float(scales.turns_per_metre)
        out = []
        for x in self.line.nodes:
            # to third order in the place: -slope bend x^3 / R
            sin, cos = dr.sincos(turns * dr.fma(-0.5 * TWO_PI * x**3, tilt, TWO_PI * x * x))
            out.append(scale_complex(dr.fma(x, dr.fma(x, curve, tilt), 1.0), (cos, sin)))
        return out

    def powers(self, types: ModuleType, scales: Scales) -> list[Complex]:
        """Phasors of the phase linear in the place, of the places 0 ... ``n_pixels // 2``."""
        out = [(types.Float32(1.0), types.Float32(0.0)), cis(types, self.slope * scales.turns_per_metre)]
        for m in range(2, self.line.n_pixels // 2 + 1):
            out.append(times(out[m // 2], out[m - m // 2]))
        return out

    def phasors(self, types: ModuleType, scales: Scales, weight: dr.ArrayBase) -> dict[int, Complex]:
        r"""Of every pixel of the lane, :math:`w (R^2 / R_0^2) e^{+j 4 \pi f_c R / c}` by its place.

        Phase and log magnitude are parabolas in the place, so the ratio of neighbours changes by a constant factor:
        outwards from the middle, two complex products per pixel.
        """
        Float = types.Float32
        out = {0: self.middle_phasor(types, scales, weight)}
        if self.line.n_pixels == 1:
            return out
        odd = cis(types, self.slope * scales.turns_per_metre)
        even = cis(types, types.Float64(self.bend) * scales.turns_per_metre)
        # ln R^2 = ln R_0^2 + 2 a m + (2 bend / R - a^2) m^2, a = slope / R
        a = Float(self.slope * self.inverse)
        curve = dr.fma(2.0 * self.bend, Float(self.inverse), -a * a)
        change = scale_complex(dr.fma(2.0 * curve, 1.0 + curve, 1.0), times(even, even))
        for sign in (1, -1):
            power = dr.fma(2.0 * sign, a, curve)
            ratio = scale_complex(
                dr.fma(power, dr.fma(0.5, power, 1.0), 1.0), times((odd[0], sign * odd[1]), even)
            )
            value = out[0]
            for place in self.line.places[::sign]:
                if place * sign > 0:
                    value = times(value, ratio)
                    ratio = times(ratio, change)
                    out[place] = value
        return out


def parabola(line: LanePixels, values: list[dr.ArrayBase]) -> list[dr.ArrayBase]:
    """Values at all pixels of a line of a function known at its nodes."""
    if line.n_pixels == 1:
        return values
    middle, low, high = values
    half = line.n_pixels // 2
    slope = (high - low) * (0.5 / half)
    bend = (high + low - 2.0 * middle) * (0.5 / half**2)
    return [dr.fma(float(m), dr.fma(float(m), bend, slope), middle) for m in line.places]


PULSE_STRIDE = 4  # float64 per pulse: antenna x, y, z, slant range of the first sample in profile samples
AXES_STRIDE = (
    16  # float32 per pulse: azimuth axis, weight; elevation axis, distance to the next pulse; boresight, the
)
# change of its sine along the flight to the next pulse; unit vector of flight, the boresight's sine along it


@dataclass(frozen=True)
class ProfileBatch:
    """The pulses of one launch.

    Parameters
    ----------
    n_pulses, n_stored, n_plane : UInt32 opaque: pulses, stored samples per pulse, samples per layer
    last : Int32 opaque: last valid position, profile samples
    positions : float64, ``PULSE_STRIDE`` per pulse
    receivers : None where each antenna receives its own echoes; else x, y, z of the receiver, float64, 3 per pulse
    axes : float32, ``AXES_STRIDE`` per pulse
    profiles : complex64 as uint64, [layer, pulse, sample] as :meth:`ProfilePlan.profiles` makes them
    """

    n_pulses: dr.ArrayBase
    n_stored: dr.ArrayBase
    n_plane: dr.ArrayBase
    last: dr.ArrayBase
    positions: dr.ArrayBase
    receivers: dr.ArrayBase | None
    axes: dr.ArrayBase
    profiles: dr.ArrayBase


@dataclass(frozen=True)
class ApertureBand:
    """The band of sines that is a pixel's aperture.

    See :func:`sarmitsuba.signal.focusing.aperture_weights.band_weights`.

    Parameters
    ----------
    half : half of the band, float32 opaque
    window : float32, nodes of the window from one end of the band to the other
    """

    half: dr.ArrayBase
    window: dr.ArrayBase

    def share(self, offset: dr.ArrayBase, per_step: dr.ArrayBase) -> dr.ArrayBase:
        """Part of a pulse inside the band, at ``offset`` from its centre; pulses are 1 / ``per_step`` apart."""
        return dr.clip(dr.fma(self.half - dr.abs(offset), per_step, 0.5), 0.0, 1.0)

    def per_step(
        self, sine: dr.ArrayBase, inverse: dr.ArrayBase, gap: dr.ArrayBase, turn: dr.ArrayBase
    ) -> dr.ArrayBase:
        """Inverse distance of neighbouring pulses' offsets.

        Of a pixel at a sine and 1 / ``inverse`` metres, from pulses ``gap`` metres apart whose beam turns by ``turn``.
        """
        return dr.rcp(dr.maximum(dr.abs(gap * inverse * (1.0 - sine * sine) + turn), 1e-12))

    def shape(self, types: ModuleType, offset: dr.ArrayBase) -> dr.ArrayBase:
        """Window at ``offset`` from the band's centre, extrapolated linearly beyond its ends."""
        last = len(self.window) - 1
        x = dr.clip(dr.fma(offset, 0.5 / self.half, 0.5), -0.25, 1.25) * float(last)
        node = types.UInt32(dr.clip(x, 0.0, last - 1.0))
        low = dr.gather(types.Float32, self.window, node)
        high = dr.gather(types.Float32, self.window, node + 1)
        return dr.fma(high - low, x - types.Float32(node), low)


@dataclass(frozen=True)
class Beam:
    """The antenna's pattern.

    Parameters
    ----------
    antenna : not isotropic
    numbers : :attr:`sarmitsuba.radar.antenna.Antenna.numbers`, float32 opaque
    """

    antenna: Antenna
    numbers: tuple[dr.ArrayBase, ...]

    @classmethod
    def of(cls, types: ModuleType, antenna: Antenna) -> Beam:
        """Beam of an antenna."""
        return cls(antenna, device_numbers(types.Float32, antenna.numbers))

    def two_way_amplitude(self, sin_azimuth: dr.ArrayBase, sin_elevation: dr.ArrayBase) -> dr.ArrayBase:
        """Relative two-way amplitude, 1 at boresight."""
        return self.antenna.normalise(sin_azimuth, sin_elevation, self.numbers, dr)


@dataclass(frozen=True)
class Weighting:
    """Weight of a pulse in a pixel: antenna pattern and aperture band.

    Parameters
    ----------
    beam : None for an isotropic antenna, whose gain is 1
    band : None where every pulse serves every pixel
    """

    beam: Beam | None
    band: ApertureBand | None

    @property
    def uniform(self) -> bool:
        """Whether a pulse has equal weight in all pixels."""
        return self.beam is None and self.band is None

    def of_line(
        self, types: ModuleType, sight: Sight, axes: dr.ArrayBase, t: dr.ArrayBase
    ) -> tuple[list[dr.ArrayBase], list[dr.ArrayBase]]:
        """Band's weight w and the antenna's amplitude g in every pixel of the lane; both vary slowly."""
        line = sight.line
        w, g = ([types.Float32(1.0)] * line.n_pixels for _ in range(2))
        if self.uniform:
            return w, g
        azimuth, elevation, boresight, forward = (dr.gather(types.Array4f, axes, 4 * t + i) for i in range(4))
        directions = [sight.direction(types, place) for place in line.bends]
        if self.band is not None:
            sines = [dot(u, forward) - forward[3] for u in directions]
            middle = sines[0] + forward[3]
            inverse = types.Float32(sight.inverse)
            per_step = self.band.per_step(middle, inverse, elevation[3], boresight[3])
            shares = [self.band.share(sine, per_step) for sine in parabola(line, sines)]
            shape = parabola(line, [self.band.shape(types, sine) for sine in sines])
            w = [share * value for share, value in zip(shares, shape, strict=True)]
        if self.beam is not None:
            gains = []
            for u in directions:
                amplitude = self.beam.two_way_amplitude(dot(u, azimuth), dot(u, elevation))
                gains.append(dr.select(dot(u, boresight) > 0.0, amplitude, 0.0))
            g = parabola(line, gains)
        return w, g


def dot(u: tuple[dr.ArrayBase, ...], v: dr.ArrayBase) -> dr.ArrayBase:
    """Scalar product with the first three entries of ``v``."""
    return dr.fma(u[0], v[0], dr.fma(u[1], v[1], u[2] * v[2]))


@dataclass(frozen=True)
class LanePulse:
    """One pulse as the pixels of every lane see it.

    Parameters
    ----------
    sight : line of sight to the middle pixel
    weight : of the pulse, float32
    weights, gains : of every pixel, the band's weight and the antenna's amplitude
    samples : UInt32, of every node, the first sample of its taps within a layer of profiles
    taps : of every node
    valid : of every node, whether the receive window contains it; empty where no node is tested
    """

    sight: Sight
    weight: dr.ArrayBase
    weights: list[dr.ArrayBase]
    gains: list[dr.ArrayBase]
    samples: list[dr.ArrayBase]
    taps: list[list[dr.ArrayBase]]
    valid: list[dr.ArrayBase]

    @classmethod
    def of(
        cls,
        types: ModuleType,
        t: dr.ArrayBase,
        middle: tuple[dr.ArrayBase, dr.ArrayBase, dr.ArrayBase],
        line: LanePixels,
        pulses: ProfileBatch,
        scales: Scales,
        kernel: GriddingKernel,
        weighting: Weighting,
    ) -> LanePulse:
        """Pulse ``t``; other parameters as for :func:`accumulate`."""
        Float, UInt32, Int32 = types.Float32, types.UInt32, types.Int32
        ax, ay, az, start = dr.gather(types.Array4f64, pulses.positions, t)
        sight = Sight.of(types, line, (middle[0] - ax, middle[1] - ay, middle[2] - az))
        if pulses.receivers is not None:
            at = [dr.gather(types.Float64, pulses.receivers, 3 * t + axis) for axis in range(3)]
            delta = tuple(m - x for m, x in zip(middle, at, strict=True))
            sight = sight.received_at(Sight.of(types, line, delta))
        pulse_weight = dr.gather(types.Float32, pulses.axes, t * AXES_STRIDE + 3)
        weights, gains = weighting.of_line(types, sight, pulses.axes, t)
        position = dr.fma(sight.distance, scales.per_metre, -start)
        whole = dr.floor(position)
        base, fraction = Int32(whole), Float(position - whole)
        per_step = Float(sight.slope * scales.per_metre)
        per_square = sight.bend * Float(scales.per_metre)
        row = Int32(t * pulses.n_stored)
        samples, taps, valid = [], [], []
        for place in line.nodes:
            x = dr.fma(place, dr.fma(place, per_square, per_step), fraction)
            floor = dr.floor(x)
            sample = base + Int32(floor)
            if line.checked:
                valid.append((sample >= 0) & (sample < pulses.last))
                sample = dr.select(valid[-1], sample, 0)
            samples.append(UInt32(row + sample))
            taps.append(kernel.taps(x - floor, dr))
        return cls(sight, pulse_weight, weights, gains, samples, taps, valid)

    def amplitude(self, pixel: int, power: int = 1) -> dr.ArrayBase:
        """Weight w g (``power`` 1) or w g^2 (2) in a pixel, zero outside the receive window."""
        value = self.weights[pixel] * self.gains[pixel]
        if power == 2:
            value = value * self.gains[pixel]
        return dr.select(self.valid[pixel], value, 0.0) if self.valid else value


def accumulate(
    types: ModuleType,
    state: list[dr.ArrayBase],
    middle: tuple[dr.ArrayBase, dr.ArrayBase, dr.ArrayBase],
    line: LanePixels,
    pulses: ProfileBatch,
    scales: Scales,
    kernel: GriddingKernel,
    n_layers: int,
    weighting: Weighting,
) -> list[dr.ArrayBase]:
    r"""Add the pulses of one batch to every pixel.

    .. math:: I_p \mathrel{+}= \sum_t w_t g_t \frac{R^2}{R_0^2} s_t(R) e^{+j 4 \pi f_c R / c}, \quad
              W_p \mathrel{+}= \sum_t w_t g_t^2, \quad R = |p - A_t|

    Parameters
    ----------
    types : array types, see :func:`sarmitsuba.machine.backend.arrays`
    state : per pixel of a lane: (re, im) per layer, then the weight; float32 arrays of one entry per lane
    middle : x, y, z of the pixel about which the lane's others are expanded, float64, m
    line : pixels of a lane
    pulses, scales : see there
    kernel : interpolation kernel of even width
    n_layers : layers in this batch
    weighting : antenna and aperture

    Notes
    -----
    The middle pixel's range and phase in turns are float64, once per lane and pulse; the others' range is a parabola in
    their place, with an error that :func:`sarmitsuba.signal.focusing.pixel_tiles.plan_line` bounds. Samples outside the
    receive window count neither in the image nor in the weight.
    """
    stride = 2 * n_layers + 1
    sums_weights = line.checked or not weighting.uniform

    def body(t: dr.ArrayBase, *old: dr.ArrayBase) -> tuple[dr.ArrayBase, ...]:
        acc = list(old)
        pulse = LanePulse.of(types, t, middle, line, pulses, scales, kernel, weighting)
        at_nodes = [
            interpolate(types, pulses, sample, taps, n_layers)
            for sample, taps in zip(pulse.samples, pulse.taps, strict=True)
        ]
        if line.direct:
            phasors = pulse.sight.phasors(types, scales, pulse.weight)
            parts = [(at_nodes[i], phasors[place]) for i, place in enumerate(line.places)]
        else:
            parts = interpolate_nodes(types, pulse.sight, scales, pulse.weight, at_nodes)
        for i, (values, factor) in enumerate(parts):
            if sums_weights:
                last = i * stride + stride - 1
                acc[last] = dr.fma(pulse.weight, pulse.amplitude(i, 2), acc[last])
                factor = scale_complex(pulse.amplitude(i), factor)
            for layer, (re, im) in enumerate(values):
                j = i * stride + 2 * layer
                acc[j] = dr.fma(re, factor[0], dr.fma(-im, factor[1], acc[j]))
                acc[j + 1] = dr.fma(re, factor[1], dr.fma(im, factor[0], acc[j + 1]))
        return (t + 1, *acc)

    out = dr.while_loop(
        state=(types.UInt32(0), *state), cond=lambda t, *_: t < pulses.n_pulses, body=body, mode="symbolic"
    )
    return list(out[1:])


def interpolate(
    types: ModuleType, pulses: ProfileBatch, first: dr.ArrayBase, taps: list[dr.ArrayBase], n_layers: int
) -> list[Complex]:
    """Profiles of all layers from the samples ``first`` ... weighted with ``taps``."""
    out = []
    for _ in range(n_layers):
        re, im = types.Float32(0.0), types.Float32(0.0)
        for k, tap in enumerate(taps):
            # complex64 as one 8-byte word: one load
            word = dr.gather(types.UInt64, pulses.profiles, first + k)
            re = dr.fma(tap, dr.reinterpret_array(types.Float32, types.UInt32(word)), re)
            im = dr.fma(tap, dr.reinterpret_array(types.Float32, types.UInt32(word >> 32)), im)
        out.append((re, im))
        first = first + pulses.n_plane
    return out


def interpolate_nodes(
    types: ModuleType, sight: Sight, scales: Scales, weight: dr.ArrayBase, at_nodes: list[list[Complex]]
) -> list[tuple[list[Complex], Complex]]:
    """Interpolated values of all layers at every pixel of the lane, and the phasors that multiply them.

    The nodes' values contain all but the phase linear in the place; the polynomial through them gives the pixels, whose
    phasors are powers of one number.
    """
    line = sight.line
    middle = sight.middle_phasor(types, scales, weight)
    factors = [times(middle, bend) for bend in sight.bends(types, scales)]
    layers = []  # sums and differences of opposite nodes
    k = line.n_nodes
    for layer in range(len(at_nodes[0])):
        values = [times(node[layer], factor) for node, factor in zip(at_nodes, factors, strict=True)]
        pairs = [(values[j], values[k - 1 - j]) for j in range(k // 2)]
        sums = [(a[0] + b[0], a[1] + b[1]) for a, b in pairs] + values[k // 2 : (k + 1) // 2]
        layers.append((sums, [(a[0] - b[0], a[1] - b[1]) for a, b in pairs]))
    powers = sight.powers(types, scales)
    out = {}
    for m in range(line.n_pixels // 2 + 1):
        even, odd = line.mix(m)
        cos, sin = powers[m]
        symmetric = [weighted_sum(even, sums) for sums, _ in layers]
        skew = [weighted_sum(odd, differences) for _, differences in layers]
        pairs = list(zip(symmetric, skew, strict=True))
        out[m] = [(e[0] + o[0], e[1] + o[1]) for e, o in pairs], (cos, sin)
        if m:
            out[-m] = [(e[0] - o[0], e[1] - o[1]) for e, o in pairs], (cos, -sin)
    return [out[place] for place in line.places]


def distribute(
    types: ModuleType,
    values: list[list[Complex]],
    middle: tuple[dr.ArrayBase, dr.ArrayBase, dr.ArrayBase],
    line: LanePixels,
    pulses: ProfileBatch,
    scales: Scales,
    kernel: GriddingKernel,
    weighting: Weighting,
    out: tuple[dr.ArrayBase, dr.ArrayBase],
) -> None:
    """Add pixels to the profiles of a batch: the adjoint of :func:`.backprojection_kernel.accumulate`.

    Parameters
    ----------
    types : array types, see :func:`sarmitsuba.machine.backend.arrays`
    values : of every pixel of a lane, of every layer, real and imaginary part, float32 arrays of one entry per lane
    middle, line, pulses, scales, kernel, weighting : as for ``accumulate``; the profiles of ``pulses`` are not read
    out : real and imaginary part of the profiles [layer, pulse, sample], float64, to which is added
    """
    lanes = len(values[0][0][0])

    def body(t: dr.ArrayBase) -> tuple[dr.ArrayBase]:
        pulse = LanePulse.of(types, t, middle, line, pulses, scales, kernel, weighting)
        pixels = values
        if line.checked or not weighting.uniform:
            pixels = [
                [scale_complex(pulse.amplitude(i), value) for value in layers]
                for i, layers in enumerate(values)
            ]
        if line.direct:
            phasors = pulse.sight.phasors(types, scales, pulse.weight)
            at_nodes = [
                [times(_conjugate(phasors[place]), value) for value in pixels[i]]
                for i, place in enumerate(line.places)
            ]
        else:
            at_nodes = _collect_at_nodes(types, pulse.sight, scales, pulse.weight, pixels)
        for i, (sample, taps, layers) in enumerate(zip(pulse.samples, pulse.taps, at_nodes, strict=True)):
            active = pulse.valid[i] if pulse.valid else True
            for value in layers:
                for k, tap in enumerate(taps):
                    for part, target in zip(value, out, strict=True):
                        dr.scatter_reduce(
                            dr.ReduceOp.Add, target, types.Float64(tap * part), sample + k, active
                        )
                sample = sample + pulses.n_plane
        return (t + 1,)

    start = dr.zeros(types.UInt32, lanes)
    dr.while_loop(state=(start,), cond=lambda t: t < pulses.n_pulses, body=body, mode="symbolic")
    dr.eval(*out)


def _conjugate(value: Complex) -> Complex:
    return value[0], -value[1]


def _collect_at_nodes(
    types: ModuleType, sight: Sight, scales: Scales, weight: dr.ArrayBase, pixels: list[list[Complex]]
) -> list[list[Complex]]:
    """Values of the nodes of all layers: the adjoint of :func:`.backprojection_kernel.interpolate_nodes`."""
    line = sight.line
    middle = sight.middle_phasor(types, scales, weight)
    factors = [times(middle, bend) for bend in sight.bends(types, scales)]
    powers = sight.powers(types, scales)
    at = {place: i for i, place in enumerate(line.places)}
    k = line.n_nodes
    mixes = [line.mix(m) for m in range(line.n_pixels // 2 + 1)]
    nodes: list[list[Complex]] = [[] for _ in range(k)]
    for layer in range(len(pixels[0])):
        even, odd = [], []  # of the pixels at places m and -m
        for m, power in enumerate(powers):
            ahead = times(_conjugate(power), pixels[at[m]][layer]) if m in at else None
            behind = times(power, pixels[at[-m]][layer]) if m else None
            if ahead is None or behind is None:
                one = ahead or behind
                assert one is not None
                sign = 1.0 if ahead else -1.0
                even.append(one)
                odd.append((sign * one[0], sign * one[1]))
            else:
                even.append((ahead[0] + behind[0], ahead[1] + behind[1]))
                odd.append((ahead[0] - behind[0], ahead[1] - behind[1]))
        for j in range(k):
            pair = min(j, k - 1 - j)
            value = weighted_sum([mix[0][pair] for mix in mixes], even)
            if 2 * j + 1 != k:
                sign = 1.0 if j < k - 1 - j else -1.0
                skew = weighted_sum([sign * mix[1][pair] for mix in mixes], odd)
                value = value[0] + skew[0], value[1] + skew[1]
            nodes[j].append(times(_conjugate(factors[j]), value))
    return nodes
