"""Pairs of images that are made without raw data."""

import numpy as np
import pytest

from sarmitsuba.analysis.baseline import second_pass
from sarmitsuba.analysis.interferometry import interferogram
from sarmitsuba.truth import theory
from sarmitsuba.truth.validation.interferometric_pairs import ROUGH, WAVELENGTH, RadarSetting
from tests.support.unweighted import render


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("share", [0.02, 0.3])
def test_method_image_keeps_phase_and_coherence(seed: int, share: float) -> None:
    """Level ground on one ground grid: coherence of theory, phase zero."""
    setting = RadarSetting.drawn(seed, 1.0)
    ground = setting.parallelogram((-110.0, -66.0, 0.0), (220.0, 0.0, 0.0), (0.0, 132.0, 0.0))
    critical = theory.critical_baseline(WAVELENGTH, setting.slant_range, setting.incidence, 1.0)
    pixels = {"pixel_spacing_azimuth": 0.4, "pixel_spacing_range": 0.6}
    first = setting.scene([ground], (ROUGH,), 80.0, **pixels)
    offset = second_pass(first.radar, 0.0, share * critical)
    second = setting.scene([ground], (ROUGH,), 80.0, **pixels, **offset.parameters)
    one, two = (render(scene, method="image") for scene in (first, second))
    whole = interferogram(one, two, one.grid.shape)
    expected = 1.0 - share
    # tol: three standard errors of the block, and 0.02 for flat spectra and small angles in the closed form
    error = (1.0 - expected**2) / np.sqrt(2.0 * whole.independent_looks)
    assert abs(whole.coherence[0, 0] - expected) < 3.0 * error + 0.02
    assert abs(whole.phase[0, 0]) < 3.0 * error / expected + 0.01
