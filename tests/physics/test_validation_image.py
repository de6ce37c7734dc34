"""Geometry and radiometry of focused images: quick runs of the validation page's cases."""

import pytest

from sarmitsuba.validation.cases import geometry as validation_geometry
from sarmitsuba.validation.cases import ground as validation_ground
from sarmitsuba.validation.cases import radiometry as validation_radiometry
from sarmitsuba.validation.comparison import CaseEntry

FAST = ("slope", "received_power", "traced_rcs", "point_rcs")
CASES = validation_geometry.CASES + validation_radiometry.CASES + validation_ground.CASES


def marks(entry: CaseEntry) -> list[pytest.MarkDecorator]:
    return [] if entry.name in FAST else [pytest.mark.slow]


@pytest.mark.filterwarnings("ignore::sarmitsuba.errors.SarmitsubaWarning")  # rays chosen by the case
@pytest.mark.parametrize(
    "entry",
    [pytest.param(e, marks=marks(e)) for e in CASES],
    ids=lambda e: e.name,
)
def test_case(entry: CaseEntry) -> None:
    """Every comparison within its own tolerance, whose reason the case states."""
    case = entry.build(True)
    assert case.passed, case.failures()
