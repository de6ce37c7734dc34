"""A part of benchmarks/studies/derivative_combinations.py: derivatives of drawn scenes against central differences."""

from collections.abc import Callable
from types import ModuleType

import pytest

# draws that are quick: one that is refused, and one with edges of metal
QUICK = (1, 3)


@pytest.mark.parametrize(
    "seed", [pytest.param(n, marks=() if n in QUICK else pytest.mark.slow) for n in range(30)]
)
def test_derivatives_are_right_or_refused(benchmark_script: Callable[[str], ModuleType], seed: int) -> None:
    study = benchmark_script("derivative_combinations")
    cells = study.cells_of(seed, list(study.CONTENTS)[seed % len(study.CONTENTS)])
    assert {cell.parameter for cell in cells} >= {*study.OF_RADAR}
    wrong = [cell for cell in cells if cell.verdict == study.WRONG]
    assert not wrong, "\n".join(f"{cell.parameter} {cell.error:.1e} {cell.command}" for cell in wrong)
