"""The compiled inner loop of backprojection: for every pixel, sum over pulses (Dr.Jit, LLVM or CUDA)."""

from __future__ import annotations

from dataclasses import dataclass
from types import ModuleType

from sarmitsuba.backend import dr
from sarmitsuba.echo.gridding import SpreadingKernel
from sarmitsuba.radar.antenna import Antenna

TWO_PI = 6.283185307179586
PULSE_STRIDE = 4  # float64 per pulse: antenna x, y, z, slant range of the first sample in profile samples
AXES_STRIDE = (
    16  # float32 per pulse: azimuth axis, weight; elevation axis, distance to the next pulse; boresight, 0;
)
# unit vector of flight, the boresight's sine along it


@dataclass(frozen=True)
class PulseBatch:
    """The pulses of one launch.

    Parameters
    ----------
    n_pulses, n_stored, n_plane : UInt32 opaque: pulses, stored samples per pulse, samples per layer
    positions : float64, ``PULSE_STRIDE`` per pulse
    axes : float32, ``AXES_STRIDE`` per pulse
    profiles : float32, [layer, pulse, sample, 4] as :meth:`ProfilePlan.paired` makes them
    """

    n_pulses: dr.ArrayBase
    n_stored: dr.ArrayBase
    n_plane: dr.ArrayBase
    positions: dr.ArrayBase
    axes: dr.ArrayBase
    profiles: dr.ArrayBase


@dataclass(frozen=True)
class Scales:
    """Numbers of the geometry, float64 opaque.

    Parameters
    ----------
    per_metre : profile samples per m of slant range
    turns_per_metre : turns of the carrier's phase per m of slant range, 2 fc / c
    last : last valid position, profile samples
    inverse_square : 1 / R_0^2, 1 / m^2
    """

    per_metre: dr.ArrayBase
    turns_per_metre: dr.ArrayBase
    last: dr.ArrayBase
    inverse_square: dr.ArrayBase


@dataclass(frozen=True)
class ApertureBand:
    """The band of sines that is a pixel's aperture, see :func:`sarmitsuba.focusing.aperture.band_weights`.

    Parameters
    ----------
    half : half of the band, float32 opaque
    window : float32, nodes of the window from one end of the band to the other
    """

    half: dr.ArrayBase
    window: dr.ArrayBase

    def weight(self, types: ModuleType, offset: dr.ArrayBase, step: dr.ArrayBase) -> dr.ArrayBase:
        """Weight of a pulse whose sine is ``offset`` from the band's centre, ``step`` from the next pulse's."""
        share = dr.clip((self.half - dr.abs(offset)) / step + 0.5, 0.0, 1.0)
        last = len(self.window) - 1
        x = dr.clip(0.5 * offset / self.half + 0.5, 0.0, 1.0) * float(last)
        node = dr.minimum(types.UInt32(x), last - 1)
        low = dr.gather(types.Float32, self.window, node)
        high = dr.gather(types.Float32, self.window, node + 1)
        return share * dr.fma(high - low, x - types.Float32(node), low)


@dataclass(frozen=True)
class Beam:
    """The antenna's pattern.

    Parameters
    ----------
    antenna : not isotropic
    per_width : :attr:`sarmitsuba.radar.antenna.Antenna.per_width`, float32 opaque
    """

    antenna: Antenna
    per_width: tuple[dr.ArrayBase, dr.ArrayBase]

    @classmethod
    def of(cls, types: ModuleType, antenna: Antenna) -> Beam:
        """Beam of an antenna."""
        azimuth, elevation = (dr.opaque(types.Float32, scale) for scale in antenna.per_width)
        return cls(antenna, (azimuth, elevation))

    def two_way_amplitude(self, sin_azimuth: dr.ArrayBase, sin_elevation: dr.ArrayBase) -> dr.ArrayBase:
        """Relative two-way amplitude, 1 at boresight."""
        return self.antenna.normalised(sin_azimuth, sin_elevation, self.per_width, dr)


def accumulate(
    types: ModuleType,
    state: list[dr.ArrayBase],
    pixels: list[tuple[dr.ArrayBase, dr.ArrayBase, dr.ArrayBase]],
    pulses: PulseBatch,
    scales: Scales,
    kernel: SpreadingKernel,
    n_layers: int,
    beam: Beam | None,
    band: ApertureBand | None,
) -> list[dr.ArrayBase]:
    r"""Add the pulses of one batch to every pixel.

    .. math:: I_p \mathrel{+}= \sum_t w_t g_t \frac{R^2}{R_0^2} s_t(R) e^{+j 4 \pi f_c R / c}, \quad
              W_p \mathrel{+}= \sum_t w_t g_t^2, \quad R = |p - A_t|

    Parameters
    ----------
    types : array types, see :func:`sarmitsuba.backend.arrays`
    state : per pixel of a lane: (re, im) per layer, then the weight; float32 arrays of one entry per lane
    pixels : x, y, z of each pixel of a lane, float64, m
    pulses, scales : see there
    kernel : interpolation kernel of even width
    n_layers : layers in this batch
    beam : None for an isotropic antenna, whose weight is 1
    band : None where every pulse serves every pixel

    Notes
    -----
    Range and phase in turns are float64, only the reduced phase is float32. The antenna's position is loaded once for
    all pixels of a lane. Samples outside the receive window count neither in the image nor in the weight.
    """
    Float, UInt32 = types.Float32, types.UInt32
    axes = pulses.axes
    stride = 2 * n_layers + 1

    def body(t: dr.ArrayBase, *old: dr.ArrayBase) -> tuple[dr.ArrayBase, ...]:
        acc = list(old)
        ax, ay, az, start = dr.gather(types.Array4f64, pulses.positions, t)
        azimuth = dr.gather(types.Array4f, axes, 4 * t)
        weight = azimuth[3]
        if beam is not None or band is not None:
            elevation = dr.gather(types.Array4f, axes, 4 * t + 1)
            boresight = dr.gather(types.Array4f, axes, 4 * t + 2)
        if band is not None:
            forward = dr.gather(types.Array4f, axes, 4 * t + 3)
        row = t * pulses.n_stored
        for i, (x, y, z) in enumerate(pixels):
            # range and carrier phase
            dx, dy, dz = x - ax, y - ay, z - az
            square = dr.fma(dx, dx, dr.fma(dy, dy, dz * dz))
            r = dr.sqrt(square)
            turns = r * scales.turns_per_metre
            sin, cos = dr.sincos(Float(turns - dr.round(turns)) * TWO_PI)

            # weights
            position = dr.fma(r, scales.per_metre, -start)
            valid = (position >= 0.0) & (position <= scales.last)
            inside = dr.select(valid, position, 0.0)
            used = dr.select(valid, weight, 0.0)
            gain = Float(square * scales.inverse_square)
            if beam is not None or band is not None:
                inverse = Float(dr.rcp(r))
                ux, uy, uz = Float(dx) * inverse, Float(dy) * inverse, Float(dz) * inverse
            if band is not None:
                sine = ux * forward[0] + uy * forward[1] + uz * forward[2]
                step = elevation[3] * inverse * (1.0 - sine * sine)
                used *= band.weight(types, sine - forward[3], step)
            if beam is not None:
                sa = ux * azimuth[0] + uy * azimuth[1] + uz * azimuth[2]
                se = ux * elevation[0] + uy * elevation[1] + uz * elevation[2]
                ahead = ux * boresight[0] + uy * boresight[1] + uz * boresight[2] > 0.0
                g = dr.select(ahead, beam.two_way_amplitude(sa, se), 0.0)
                gain *= used * g
                used *= g * g
            else:
                gain *= used
            sin *= gain
            cos *= gain
            acc[i * stride + stride - 1] += used

            # interpolate every layer at this range and add
            floor = dr.floor(inside)
            taps = kernel.taps(Float(inside - floor), dr)
            first = row + UInt32(floor)
            for layer in range(n_layers):
                re, im = Float(0.0), Float(0.0)
                for k in range(0, kernel.width, 2):
                    pair = dr.gather(types.Array4f, pulses.profiles, first + k)
                    re = dr.fma(taps[k], pair[0], dr.fma(taps[k + 1], pair[2], re))
                    im = dr.fma(taps[k], pair[1], dr.fma(taps[k + 1], pair[3], im))
                j = i * stride + 2 * layer
                acc[j] = dr.fma(re, cos, dr.fma(-im, sin, acc[j]))
                acc[j + 1] = dr.fma(re, sin, dr.fma(im, cos, acc[j + 1]))
                if layer + 1 < n_layers:
                    first += pulses.n_plane
        return (t + 1, *acc)

    out = dr.while_loop(
        state=(UInt32(0), *state), cond=lambda t, *_: t < pulses.n_pulses, body=body, mode="symbolic"
    )
    return list(out[1:])


__all__ = ["AXES_STRIDE", "PULSE_STRIDE", "ApertureBand", "PulseBatch", "Scales", "accumulate"]
