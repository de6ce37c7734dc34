"""A link budget as a table to read."""

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from sarmitsuba.link.place import PlaceBudget
from sarmitsuba.memory import in_bytes
from sarmitsuba.units import db_from_power

if TYPE_CHECKING:
    from sarmitsuba.link.budget import LinkBudget

# bands of free pulse repetition frequencies that are listed
_FREE_SHOWN = 5


def table(budget: "LinkBudget") -> str:
    """Several lines."""
    t, middle = budget.timing, budget.middle
    radar = [
        ("mode", f"{budget.mode}, {middle.n_pulses} pulses in an aperture"),
        ("wavelength, speed", f"{budget.wavelength:.5g} m, {budget.speed:.5g} m/s"),
        (
            "peak, average power",
            f"{t.peak_power:.4g} W, {t.average_power:.4g} W (duty cycle {100 * t.duty_cycle:.3g} %)",
        ),
        (
            "gain, losses",
            f"{db_from_power(budget.gain):.2f} dB one way, {db_from_power(budget.losses):.2f} dB two-way",
        ),
        ("antenna", "isotropic" if np.isinf(budget.antenna_area) else f"{budget.antenna_area:.4g} m^2"),
        (
            "noise temperature",
            f"{budget.noise_temperature:.4g} K" if budget.noise_temperature else "not given",
        ),
        ("windows", f"range {budget.range_window}, azimuth {budget.azimuth_window}"),
    ]
    pulses = [
        ("prf", f"{t.prf:.6g} Hz, interval {1e6 / t.prf:.5g} us"),
        ("prf bounds", f"{t.lowest_prf:.5g} Hz (Doppler) to {t.highest_prf:.5g} Hz (swath)"),
        (
            "Doppler bandwidth",
            f"processed {t.processed_bandwidth:.5g} Hz, beam {_or(t.beam_bandwidth, '.5g')} Hz",
        ),
        (
            "echoes arrive",
            f"{1e6 * t.echo_begins:.6g} to {1e6 * t.echo_ends:.6g} us, {t.pulses_in_flight} pulses in flight",
        ),
        ("nadir's echo", f"{1e6 * t.nadir_begins:.6g} us"),
        ("free prf", _bands(t.free_prf, t.prf)),
        (
            "raw data",
            f"{budget.data.samples:.4g} samples, {in_bytes(budget.data.bytes)}, {in_bytes(budget.data.rate)}/s for "
            f"{budget.data.seconds:.3g} s",
        ),
    ]
    width = max(len(name) for name, _ in (*radar, *pulses, *((label, "") for label, _ in _ROWS)))
    lines = [f"{budget.scene}:", *(f"  {name:<{width}}  {value}" for name, value in (*radar, *pulses))]
    columns = [[place.name, *(value(place) for _, value in _ROWS)] for place in budget.places]
    sizes = [max(len(cell) for cell in column) for column in columns]
    for i, label in enumerate(("swath", *(label for label, _ in _ROWS))):
        cells = "  ".join(f"{column[i]:>{size}}" for column, size in zip(columns, sizes, strict=True))
        lines.append(f"  {label:<{width}}  {cells}")
    lines += [
        f"  {'impossible' if finding.impossible else 'mind'}: {finding.text}" for finding in budget.findings
    ]
    return "\n".join(lines)


def _or(value: float, form: str) -> str:
    return format(value, form) if np.isfinite(value) else "-"


def _db(value: float) -> str:
    return _or(float(db_from_power(value)), ".2f") if value > 0.0 else "-"


def _bands(bands: tuple[tuple[float, float], ...], prf: float) -> str:
    """Those next to the pulse repetition frequency."""
    if not bands:
        return "none"
    near = sorted(bands, key=lambda band: max(band[0] - prf, prf - band[1]))[:_FREE_SHOWN]
    shown = ", ".join(f"{low:.5g} to {high:.5g}" for low, high in sorted(near))
    return f"{shown} Hz{f' ({len(bands)} bands in all)' if len(bands) > len(near) else ''}"


_ROWS: tuple[tuple[str, Callable[[PlaceBudget], str]], ...] = (
    ("slant range (m)", lambda p: f"{p.slant_range:.7g}"),
    ("incidence (deg)", lambda p: f"{np.degrees(p.incidence_angle):.3f}"),
    ("two-way pattern (dB)", lambda p: _db(p.pattern)),
    ("aperture (m)", lambda p: f"{p.aperture_length:.5g}"),
    ("aperture (s)", lambda p: f"{p.aperture_time:.4g}"),
    ("range resolution (m)", lambda p: f"{p.range_resolution:.4g}"),
    ("on the ground (m)", lambda p: f"{p.ground_range_resolution:.4g}"),
    ("azimuth resolution (m)", lambda p: f"{p.azimuth_resolution:.4g}"),
    ("SNR of the point (dB)", lambda p: _db(p.snr)),
    ("SNR of the ground (dB)", lambda p: _db(p.snr_ground)),
    ("NESZ (dB)", lambda p: _db(p.nesz)),
    ("NESZ, textbook (dB)", lambda p: _db(p.nesz_textbook)),
    ("azimuth ambiguity (dB)", lambda p: _db(p.azimuth_ambiguity)),
    ("range ambiguity (dB)", lambda p: _db(p.range_ambiguity)),
)

__all__ = ["table"]
