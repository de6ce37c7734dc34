"""Offsets of envelopes from so few pulses that azimuth repeats within the reach of the search."""

from __future__ import annotations

import numpy as np
import pytest

import sarmitsuba
from sarmitsuba.apps.fit import fit as fits
from sarmitsuba.apps.fit.forward_model import ForwardModel
from sarmitsuba.apps.fit.parsing import parse
from sarmitsuba.apps.fit.shape_offsets import moving_parts, offset
from tests.apps.test_gradients import plate


@pytest.mark.parametrize("axis", ["x", "y"])
def test_an_offset_is_not_taken_for_its_repetition(axis: str) -> None:
    """A shift by a third of a metre was found 20 m away: eight pulses repeat the peak every seven azimuth cells."""
    scene = plate(squint_angle_deg=0.0, n_pulses=8, azimuth_resolution=3.0, heading_deg=30.0)
    model = ForwardModel(scene, parse(f"shift:plate:{axis}", scene))
    (part,) = moving_parts(model, model.start)
    own = np.fft.fft(model.data().astype(np.complex128), axis=-1)
    data = np.fft.fft(model.data(model.start + 0.3).astype(np.complex128), axis=-1)
    found = offset(model, part, data, own)
    assert found is not None
    # tol: half an azimuth cell of 3 m; the next repetition is 21 m away
    assert abs(found.azimuth) < 1.5


def test_a_start_that_led_astray_is_left(monkeypatch: pytest.MonkeyPatch) -> None:
    """Coarse steps that moved a shape out of the data ended the fit with an error that its own start does not give."""
    scene = plate()
    raw = sarmitsuba.simulate(scene)
    word = "shift:plate:z"
    # 400 m up, before the receive window
    away = (np.array([400.0]), np.array([np.nan]))
    monkeypatch.setattr(fits, "coarse_shapes", lambda *_: away)
    found = sarmitsuba.fit(scene, raw, word)
    # tol: float32 of exact data
    assert found.values[0] == pytest.approx(0.0, abs=1e-5)
