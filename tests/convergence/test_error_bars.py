"""The error that the subsets estimate against the true error, and its fall with more rays."""

from dataclasses import replace

import numpy as np
import pytest

from sarmitsuba.loading.load import load_scene
from sarmitsuba.signal.focusing import default_grid
from sarmitsuba.signal.image import SarImage
from sarmitsuba.signal.metrics import image_error_db
from sarmitsuba.simulation.execution.error_bars import PASSES, estimate_error
from sarmitsuba.simulation.execution.raw import echoes
from sarmitsuba.simulation.execution.run import Run
from sarmitsuba.simulation.planning.sampling.density_plan import SamplingPlan
from sarmitsuba.simulation.planning.sampling.piece import crop
from tests.support.unweighted import focus, refine, render

# draws of both lattices that are averaged
RUNS = 4


@pytest.mark.parametrize("name", ["tower", pytest.param("buildings16", marks=pytest.mark.slow)])
def test_estimate_follows_the_truth(name: str) -> None:
    whole = load_scene(name)
    sampling = SamplingPlan.of(whole)
    scene = crop(whole, 0.35)
    grid = default_grid(scene.radar, scene.image)

    def run(factor: float, index: int, subsets: bool) -> SarImage:
        settings = replace(
            scene.settings,
            **sampling.spacings.at(factor),
            scatterer_cell=sampling.scatterer_cell,
            max_depth=3,
            keep_subsets=subsets,
        )
        return render(replace(scene, settings=settings), method="image", grid=grid, pass_index=index)

    reference = np.mean([run(0.3, 50 + i, False).total() for i in range(2)], axis=0)
    found = []
    for factor in (1.0, 0.5):
        images = [run(factor, i, True) for i in range(RUNS)]
        bars = [estimate_error(image.data, image.layers, pixels=False) for image in images]
        estimate = mean_db([bar.error_db[0] for bar in bars])
        true = mean_db([image_error_db(image.total(), reference) for image in images])
        # tol: what both lattices blur alike is one constant for all scenes, within 1.5 dB in these two
        # (benchmarks/suite/error_bars.py); 0.5 dB for the mean of four draws of 1 dB
        assert abs(estimate - true) < 2.0
        found.append(true)
        for bar, image in zip(bars, images, strict=True):
            # the truth of one draw lies within two of the standard deviations that are stated with the estimate
            off = bar.error_db[0] - image_error_db(image.total(), reference)
            assert abs(off) < 2.0 * bar.confidence_db[0]
    # a quarter of the tubes' area: what is left comes from outlines, whose error falls with the tubes' width, 3 dB;
    # 1 dB for the mean of four draws
    assert found[1] < found[0] - 2.0


@pytest.mark.slow
@pytest.mark.parametrize("name", ["tower", "buildings16"])
def test_finished_passes_state_their_error(name: str) -> None:
    """The stated error is the true one within its own uncertainty, and what it is at most holds.

    Before: the subsets of the mean of passes, blind to what lattices of every density blur alike, said 2 to 3 dB less.
    """
    whole = crop(load_scene(name), 0.35, 0.1)
    scene = replace(whole, settings=replace(whole.settings, max_depth=3, key_pulse_interval=64))
    done = refine(scene, target_error_db=-199.0, max_passes=3)
    run = Run(scene).at(2.0 ** (-0.5 * 5))  # eight times the rays of the last pass
    reference = focus(echoes(run, pass_index=99), done.image.grid).total()
    bar = next(iter(done.image.metadata["sampling_error"].values()))
    true = image_error_db(done.image.total(), reference)
    print(name, bar, true)
    assert bar["source"] == PASSES
    # tol: two of the standard deviations that are stated with it; the reference's own error is -7 dB of it, 0.8 dB
    assert abs(bar["error_db"] - true) < 2.0 * bar["confidence_db"] + 0.8
    # holds in 95 % of drawn runs (benchmarks/suite/error_bars.py); tol: the rms of the estimates there, since one of
    # these two scenes may be of the other 5 %: buildings16 is, by 1.1 dB
    assert true < bar["at_most_db"] + 1.5


def mean_db(values: list[float]) -> float:
    """Mean of energies given in dB."""
    return 10.0 * float(np.log10(np.mean(10.0 ** (np.array(values) / 10.0))))
