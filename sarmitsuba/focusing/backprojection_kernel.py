"""The compiled inner loop of backprojection: for every pixel, sum over pulses (Dr.Jit, LLVM or CUDA)."""

from typing import Any

from sarmitsuba.echo.gridding import SpreadingKernel
from sarmitsuba.radar.antenna import Antenna

TWO_PI = 6.283185307179586
PULSE_STRIDE = 4  # float64 per pulse: antenna x, y, z, slant range of the first sample in profile samples
AXES_STRIDE = 16  # float32 per pulse: azimuth axis and weight, elevation axis and 0, boresight and 0, 0 0 0 0


class _Operand:
    """A Dr.Jit array that meets NumPy scalars: without this they would try to evaluate it inside the loop."""

    __array_ufunc__ = None

    def __init__(self, value: Any) -> None:
        self.value = value

    def __rmul__(self, other: Any) -> Any:
        return self.value * float(other)

    def __truediv__(self, other: Any) -> Any:
        return self.value / float(other)


def accumulate(
    dr: Any,
    types: Any,
    state: list[Any],
    pixels: list[tuple[Any, Any, Any]],
    pulses: Any,
    axes: Any,
    profiles: Any,
    counts: tuple[Any, Any, Any],
    scales: tuple[Any, Any, Any, Any],
    kernel: SpreadingKernel,
    n_layers: int,
    antenna: Antenna | None,
) -> list[Any]:
    r"""Add the pulses of one batch to every pixel.

    .. math:: I_p \mathrel{+}= \sum_t w_t g_t \frac{R^2}{R_0^2} s_t(R) e^{+j 4 \pi f_c R / c}, \quad
              W_p \mathrel{+}= \sum_t w_t g_t^2, \quad R = |p - A_t|

    Parameters
    ----------
    dr, types : ``drjit`` and ``drjit.llvm`` or ``drjit.cuda``
    state : per pixel of a lane: (re, im) per layer, then the weight; float32 arrays of one entry a lane
    pixels : x, y, z of each pixel of a lane, float64, m
    pulses : float64, ``PULSE_STRIDE`` a pulse
    axes : float32, ``AXES_STRIDE`` a pulse
    profiles : float32, [layer, pulse, sample, 4] as :meth:`ProfilePlan.paired` makes them
    counts : UInt32 opaque: pulses, stored samples a pulse, samples a layer
    scales : float64 opaque: profile samples per m, carrier turns per m (2 fc / c), last valid position, 1 / R_0^2
    kernel : interpolation kernel of even width
    n_layers : layers in this batch
    antenna : None for an isotropic one, whose weight is 1

    Notes
    -----
    Range and phase in turns are float64, only the reduced phase is float32. The antenna's position is loaded once for
    all pixels of a lane. Samples outside the receive window count neither in the image nor in the weight.
    """
    Float, UInt32 = types.Float32, types.UInt32
    n_pulses, n_stored, n_plane = counts
    per_metre, turns_per_metre, last, inverse_square = scales
    stride = 2 * n_layers + 1

    def body(t: Any, *old: Any) -> tuple[Any, ...]:
        acc = list(old)
        ax, ay, az, start = dr.gather(types.Array4f64, pulses, t)
        azimuth = dr.gather(types.Array4f, axes, 4 * t)
        weight = azimuth[3]
        if antenna is not None:
            elevation = dr.gather(types.Array4f, axes, 4 * t + 1)
            boresight = dr.gather(types.Array4f, axes, 4 * t + 2)
        row = t * n_stored
        for i, (x, y, z) in enumerate(pixels):
            # range and carrier phase
            dx, dy, dz = x - ax, y - ay, z - az
            square = dr.fma(dx, dx, dr.fma(dy, dy, dz * dz))
            r = dr.sqrt(square)
            turns = r * turns_per_metre
            sin, cos = dr.sincos(Float(turns - dr.round(turns)) * TWO_PI)

            # weights
            position = dr.fma(r, per_metre, -start)
            valid = (position >= 0.0) & (position <= last)
            inside = dr.select(valid, position, 0.0)
            used = dr.select(valid, weight, 0.0)
            gain = Float(square * inverse_square)
            if antenna is not None:
                inverse = Float(dr.rcp(r))
                ux, uy, uz = Float(dx) * inverse, Float(dy) * inverse, Float(dz) * inverse
                sa = ux * azimuth[0] + uy * azimuth[1] + uz * azimuth[2]
                se = ux * elevation[0] + uy * elevation[1] + uz * elevation[2]
                ahead = ux * boresight[0] + uy * boresight[1] + uz * boresight[2] > 0.0
                g = dr.select(ahead, antenna.two_way_amplitude(_Operand(sa), _Operand(se), xp=dr), 0.0)
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
                    pair = dr.gather(types.Array4f, profiles, first + k)
                    re = dr.fma(taps[k], pair[0], dr.fma(taps[k + 1], pair[2], re))
                    im = dr.fma(taps[k], pair[1], dr.fma(taps[k + 1], pair[3], im))
                j = i * stride + 2 * layer
                acc[j] = dr.fma(re, cos, dr.fma(-im, sin, acc[j]))
                acc[j + 1] = dr.fma(re, sin, dr.fma(im, cos, acc[j + 1]))
                if layer + 1 < n_layers:
                    first += n_plane
        return (t + 1, *acc)

    out = dr.while_loop(
        state=(UInt32(0), *state), cond=lambda t, *_: t < n_pulses, body=body, mode="symbolic"
    )
    return list(out[1:])


__all__ = ["AXES_STRIDE", "PULSE_STRIDE", "accumulate"]
