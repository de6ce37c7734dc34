"""A part of benchmarks/studies/combinations.py: drawn combinations against the exact sum over a point's echoes."""

from collections.abc import Callable
from dataclasses import replace
from types import ModuleType

import numpy as np
import pytest

from sarmitsuba.radar.mode import MODES
from sarmitsuba.signal.focusing import FOCUSERS
from sarmitsuba.simulation.execution.render import simulate
from tests.support.unweighted import focus

# the draw of each mode that is quick: of few pulses, 0 where the mode is new
QUICK = {"stripmap": 8, "sliding_spotlight": 3, "circular": 3}
# a draw whose aperture has few pulses
SHORT = 3


@pytest.fixture
def combinations(benchmark_script: Callable[[str], ModuleType]) -> ModuleType:
    return benchmark_script("combinations")


def check(combinations: ModuleType, mode: str, seed: int) -> None:
    cells = list(combinations.cells_of(combinations.draw(mode, seed)))
    assert {cell.column for cell in cells} == {*FOCUSERS.own_names, "auto,error=-50", "image", "raster"}
    wrong = [cell for cell in cells if cell.verdict == combinations.WRONG]
    assert not wrong, "\n".join(cell.text() for cell in wrong)


@pytest.mark.parametrize("mode", MODES.names)
def test_a_few_combinations_are_right_or_say_so(combinations: ModuleType, mode: str) -> None:
    check(combinations, mode, QUICK.get(mode, 0))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("mode", "seed"), [(m, n) for m in MODES.names for n in range(20) if n != QUICK.get(m, 0)]
)
def test_all_combinations_are_right_or_say_so(combinations: ModuleType, mode: str, seed: int) -> None:
    check(combinations, mode, seed)


@pytest.mark.slow
def test_the_matrix_sees_small_errors(combinations: ModuleType) -> None:
    # an image that is off by little more than is right, each way
    drawn = combinations.draw("spotlight", SHORT)
    scene = drawn.scene()
    windows = {"range_window": drawn.windows[0], "azimuth_window": drawn.windows[1]}
    truth = combinations.Truth(drawn, scene)
    image = focus(simulate(scene), request=scene.image, **windows)
    assert truth.compare(image)[0].badness() < 1.0
    for wrong in (
        replace(image, data=image.data * np.float32(10.0**0.0035)),  # 0.07 dB
        replace(image, data=image.data * np.complex64(np.exp(1j * np.radians(1.3)))),
    ):
        assert truth.compare(wrong)[0].badness() > 1.1
    grid = image.grid
    for moved in (
        replace(grid, azimuth=grid.azimuth + 0.07 * drawn.cells[0]),
        replace(grid, range=grid.range + 0.07 * drawn.cells[1]),
    ):
        # a truth keeps the exact image of one grid
        elsewhere = combinations.Truth(drawn, scene)
        assert elsewhere.compare(replace(image, grid=moved))[0].badness() > 1.1
