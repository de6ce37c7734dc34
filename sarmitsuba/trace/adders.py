"""Where contributions go: per-lane sums (RCS), per-pulse range grids (direct) or range-rate grids (block)."""

from collections.abc import Sequence
from typing import Any


class SumAdder:
    """Coherent sum in the lane itself, for look-by-look radar cross sections; no memory traffic at all.

    Parameters
    ----------
    wavelength : m
    reference_half_length : (n_pulses,) Dr.Jit float64, m, subtracted from half lengths before the phase is formed
    n_channels : amplitudes a contribution
    max_order : orders kept apart, 1..max_order; 0 sums all orders
    """

    def __init__(self, wavelength: float, reference_half_length: Any, n_channels: int, max_order: int = 0) -> None:
        self.wavelength = wavelength
        self.reference = reference_half_length
        self.n_channels = n_channels
        self.max_order = max_order

    def begin(self) -> tuple[Any, ...]:
        """One complex zero per channel and order."""
        import mitsuba as mi

        return tuple(mi.Complex2f(0.0, 0.0) for _ in range(self.n_channels * max(1, self.max_order)))

    def add(
        self, state: tuple[Any, ...], order: Any, pulse: Any, half_length: Any, rate: Any, amplitudes: Sequence[Any],
        active: Any,
    ) -> tuple[Any, ...]:
        """Add into the lane's sums; see :class:`sarmitsuba.trace.kernel.Adder`."""
        import drjit as dr
        import mitsuba as mi

        reference = dr.gather(mi.Float64, self.reference, pulse, active)
        phasor = carrier(half_length - reference, self.wavelength, mi, dr)
        out = list(state)
        for o in range(max(1, self.max_order)):
            mine = active if self.max_order == 0 else active & (order == o + 1)
            for i, a in enumerate(amplitudes):
                j = o * self.n_channels + i
                out[j] = out[j] + dr.select(mine, a * phasor, mi.Complex2f(0.0))
        return tuple(out)


def carrier(half_length: Any, wavelength: float, mi: Any, dr: Any) -> Any:
    """``exp(-j 4 pi x / lambda)`` of a float64 half length: reduced to one cycle in float64, sine in float32."""
    cycles = half_length * dr.opaque(mi.Float64, 2.0 / wavelength)
    s, c = dr.sincos(mi.Float(cycles - dr.floor(cycles)) * (2.0 * dr.pi))
    return mi.Complex2f(c, -s)


__all__ = ["SumAdder", "carrier"]
