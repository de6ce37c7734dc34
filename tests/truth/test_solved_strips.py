"""What separates plates from infinite strips: the measured plate against the strip solved by the method of moments."""

import numpy as np
import pytest

from sarmitsuba.core.constants import SPEED_OF_LIGHT
from sarmitsuba.truth import theory
from sarmitsuba.truth.validation.cases.measured import FLOOR
from sarmitsuba.truth.validation.measured.azimuth_tables import azimuth_table
from sarmitsuba.truth.validation.measured.bodies import PLATE_HEIGHT, PLATE_WIDTH


@pytest.mark.parametrize(
    ("frequency", "low", "high"),
    [(2.56e9, 1.5, 3.5), (5.12e9, 0.0, 0.35), (7e9, 0.0, 0.25), (10.2e9, 0.0, 0.2)],
)
def test_all_waves_between_the_upright_rims_leave_the_corners(
    frequency: float, low: float, high: float
) -> None:
    """Every order of diffraction between two parallel rims: the rest is corners and the rims that the wave grazes."""
    wavelength = SPEED_OF_LIGHT / frequency
    for channel in ("HH", "VV"):
        table = azimuth_table("II_A_sx1", frequency, channel)
        strip = [(0.0, -0.5 * PLATE_WIDTH), (0.0, 0.5 * PLATE_WIDTH)]
        solved = theory.strips_by_moments([strip], wavelength, np.radians(table.azimuth))
        # upright rims: VV has the field along them
        width = np.abs(solved[1 if channel == "HH" else 0]) ** 2
        inside = table.solver > table.solver.max() - FLOOR
        level = 10.0 * np.log10(2.0 * PLATE_HEIGHT**2 / wavelength * width[inside])
        rms = float(np.sqrt(np.mean((level - table.solver[inside]) ** 2)))
        print(f"{1e-9 * frequency:g} GHz, {channel}: rms {rms:.2f} dB with the solved strip")
        # tol: what is measured here; it bounds what waves between parallel rims can win
        assert low < rms < high
