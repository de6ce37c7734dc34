"""What derivatives and fits do with arguments that are none: one line of the project's own, never another number."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import sarmitsuba
from sarmitsuba import Prior
from sarmitsuba.apps.fit.least_squares import known_priors
from sarmitsuba.apps.fit.losses import check_loss
from sarmitsuba.apps.fit.parsing import parse
from sarmitsuba.core.errors import DataError, SceneError
from sarmitsuba.signal.raw_data import RawData
from tests.apps.test_gradients import plate


@pytest.mark.parametrize("word", ["shift:plate:xy", "shift:plate:yz", "shifts:xyz"])
def test_an_axis_is_one_letter(word: str) -> None:
    """``shift:plate:xy`` was a shift along x."""
    with pytest.raises(SceneError, match=r"shift:SHAPE:AXIS"):
        parse(word, plate())


def test_numbers_of_values() -> None:
    data = np.zeros((1, 4, 3), dtype=np.complex64)
    raw: Any = None  # not looked at
    found = sarmitsuba.apps.fit.jacobian.Jacobian(
        ("gain [dB]", "level:soil [dB]"), np.zeros(2), data[None], raw
    )
    assert found.number(np.int64(1)) == 1 and found.number(-1) == -1
    nothing: tuple[Any, ...] = (2, -3, True, 1.0, None, "level")
    for wrong in nothing:
        with pytest.raises(SceneError, match="no parameter"):
            found.number(wrong)


@pytest.mark.parametrize(
    "prior",
    [Prior(-12.0, -3.0), Prior(0.0, 1e200), Prior(0.0, 1e-200), Prior(1e300, 1.0), Prior(np.nan, 1.0)],
)
def test_priors_that_are_none(prior: Prior) -> None:
    """A sigma of -3 was taken for 3, and squares overflowed."""
    with pytest.raises(SceneError, match="prior of 'gain'"):
        known_priors(("gain [dB]",), {"gain": prior})
    assert known_priors(("gain [dB]",), {"gain": Prior(0.0, np.inf)})


@pytest.mark.parametrize("size", [1e-60, 1.0, 1e200])
def test_adjoints_of_any_size(size: float) -> None:
    """Adjoint data of 1e-60 gave a gradient of 0, of 1e200 one that is no number."""
    data = np.ones((1, 2, 2), dtype=np.complex64)
    double: Any = lambda d: (1.0, size * d.astype(np.complex128))  # noqa: E731
    _, adjoint = check_loss(double, data)
    np.testing.assert_array_equal(adjoint, size * data.astype(np.complex128))


def test_measured_data_and_weights_that_are_none() -> None:
    data = np.ones((1, 2, 2), dtype=np.complex64)
    for measured in ("raw.h5", None, [[["a"]]]):
        with pytest.raises(DataError, match="measured is"):
            sarmitsuba.SquaredDifference(measured)  # type: ignore[arg-type]
    for weights in ("a", np.array([1.0 + 1.0j]), [None]):
        with pytest.raises(DataError, match="weights are"):
            sarmitsuba.SquaredDifference(data, weights)  # type: ignore[arg-type]


def test_scenes_and_data_that_are_none() -> None:
    scene, none = plate(), np.zeros((1, 4, 4))
    for data in (None, 3, "raw.h5", none):
        with pytest.raises(DataError, match=r"raw data are expected|not ndarray"):
            sarmitsuba.fit(scene, data, "gain")  # type: ignore[arg-type]
    with pytest.raises(SceneError, match="is no scene"):
        sarmitsuba.fit(None, object.__new__(RawData), "gain")  # type: ignore[arg-type]


def test_values_that_are_none() -> None:
    objective = sarmitsuba.Objective(plate(), "gain,level:soil", lambda d: (0.0, d))
    for values in ("abc", [1j, 0.0], [[1.0], [2.0, 3.0]], {"gain": 1.0}):
        with pytest.raises(SceneError, match="are no real numbers"):
            objective(values)  # type: ignore[arg-type]
    with pytest.raises(SceneError, match=r"not \(2, 1\)"):
        objective(np.zeros((2, 1)))
