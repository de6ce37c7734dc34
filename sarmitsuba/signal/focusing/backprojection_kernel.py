"""Compiled inner loop of backprojection: for every pixel, sum over pulses (Dr.Jit, LLVM or CUDA)."""

from __future__ import annotations

from dataclasses import dataclass
from types import ModuleType
from typing import TYPE_CHECKING

from sarmitsuba.machine.backend import device_numbers, dr
from sarmitsuba.radar.antenna import Antenna
from sarmitsuba.signal.focusing.device_complex import scaled, times, weighted_sum
from sarmitsuba.signal.focusing.lane_sight import LanePixels, Scales, Sight, parabola
from sarmitsuba.signal.raw.gridding import GriddingKernel

if TYPE_CHECKING:
    Complex = tuple[dr.ArrayBase, dr.ArrayBase]

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
        return self.antenna.normalised(sin_azimuth, sin_elevation, self.numbers, dr)


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
    their place, with an error that :func:`sarmitsuba.signal.focusing.pixel_lines.plan_line` bounds. Samples outside the
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
            parts = between_nodes(types, pulse.sight, scales, pulse.weight, at_nodes)
        for i, (values, factor) in enumerate(parts):
            if sums_weights:
                last = i * stride + stride - 1
                acc[last] = dr.fma(pulse.weight, pulse.amplitude(i, 2), acc[last])
                factor = scaled(pulse.amplitude(i), factor)
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


def between_nodes(
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
