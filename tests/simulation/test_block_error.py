"""The rays' own error, which decides whether shorter blocks are worth their time."""

from dataclasses import replace

import numpy as np
import pytest

from sarmitsuba.loading.library import resolve
from sarmitsuba.loading.load import load_scene
from sarmitsuba.scene.scene import Scene
from sarmitsuba.simulation.execution import blocks as blocks_module
from sarmitsuba.simulation.execution.blocks import Blocks
from sarmitsuba.simulation.execution.run import Run
from sarmitsuba.simulation.execution.tracing import Tracer
from sarmitsuba.simulation.planning.sampling.rays import Rays
from sarmitsuba.tracing.kernel.launch import LatticeLevel, LaunchFrame, lattice


def test_levels_shift_by_half_a_cell_of_their_own() -> None:
    """Finer rays over a small part stay over it."""
    grid = lattice(4.0, 4.0, 0.5)
    half = grid.n_rays // 2
    grid = replace(grid, levels=(LatticeLevel(0, 0.5, (0.1, np.inf)), LatticeLevel(half, 0.05, (0.0, 0.1))))
    moved = blocks_module._shift_lattice(grid)
    step = np.hypot(moved.x - grid.x, moved.y - grid.y)
    np.testing.assert_allclose(step[:half], 0.5 * np.sqrt(0.5), rtol=1e-5)  # tol: float32 coordinates
    np.testing.assert_allclose(step[half:], 0.05 * np.sqrt(0.5), rtol=1e-4)  # tol: float32 coordinates


def test_strip_keeps_levels() -> None:
    """Rays of a strip keep the level they had."""
    grid = lattice(40.0, 10.0, 0.5, taper=2.0)
    first = grid.n_rays // 3
    grid = replace(grid, levels=(LatticeLevel(0, 0.5, (0.1, np.inf)), LatticeLevel(first, 0.05, (0.0, 0.1))))
    frame = LaunchFrame(*np.zeros((3, 1, 3)))
    strip = blocks_module.strip(grid, frame)
    keep = np.abs(grid.x) <= strip.half_x + strip.taper
    assert 0 < strip.n_rays < 0.1 * grid.n_rays
    np.testing.assert_array_equal(strip.x, grid.x[keep])
    np.testing.assert_array_equal(strip.level, grid.level[keep])


def _blocks(scene: Scene) -> tuple[Blocks, Rays]:
    run = Run(scene)
    assert run.sampling is not None
    tracer, rays = run.tracer(run.sampling), run.rays(run.sampling, 0)
    radar, layers = scene.radar, run.layers.layers
    data = np.zeros((len(layers), radar.track.n_pulses, radar.window.n_samples), dtype=np.complex64)
    return Blocks(tracer, rays, layers, data, run.layers.max_order), rays


def test_coarser_rays_do_not_shorten_blocks_but_where_their_measured_error_asks_for_it() -> None:
    """Blocks as short as wide tubes keep their amplitudes had urban_block's coarser rays trace more, not fewer."""
    scene = load_scene(resolve("urban_block"))
    automatic = Run(scene).sampling
    assert automatic is not None
    coarser = Run(scene.replace(ray_spacing=2.83 * automatic.spacings.coherent)).sampling
    assert coarser is not None
    assert coarser.key_pulse_interval == automatic.key_pulse_interval
    # denser rays: the width of the tubes counts
    widths = 0.5 * automatic.half_cell, automatic.half_cell
    assert automatic.steady_pulses(widths[0]) == pytest.approx(2.0 * automatic.steady_pulses(widths[1]))


def test_wide_tubes_shorten_blocks_at_first_to_where_they_keep_their_amplitudes(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The change by wide tubes falls faster with shorter blocks than other changes, after which none may be left."""
    monkeypatch.setattr(blocks_module, "WORTH_DB", -10.0)  # blocks far better than rays are asked for
    tower = load_scene(resolve("tower"))
    wide = 4.0 * Run(tower).sampling.spacings.coherent  # type: ignore[union-attr]
    made, _ = _blocks(tower.replace(ray_spacing=wide))
    steady = made.tracer.sampling.steady_pulses(wide)
    assert made.interval > 2.0 * steady
    made.block(made._middle)
    made.block(made._middle + 1)
    assert 0.5 * steady < made._shorter() <= steady * (1.0 + 1.0 / 16.0)  # lengths come in steps of 1.5


def test_where_every_pulse_is_traced_no_block_is_looked_at() -> None:
    """Blocks of two pulses far apart would need grids of any size."""
    made, _ = _blocks(load_scene(resolve("sphere"), parameters={"sar_path.key_pulse_interval": "1"}))
    assert made.survey(10**12) == (0, 0)
    assert not made.done


@pytest.mark.filterwarnings("ignore:.*wideband is switched off")
@pytest.mark.parametrize("strips", [True, False])
def test_a_strip_decides_as_all_rays_do(monkeypatch: pytest.MonkeyPatch, strips: bool) -> None:
    """The tower's blocks stay as they are by either way, by a strip with a fraction of the rays."""
    monkeypatch.setattr(blocks_module, "STRIP_FROM", 0 if strips else np.inf)
    scene = load_scene(resolve("tower"))
    settings = replace(
        scene.settings,
        tolerance_db=-60.0,
        keep_subsets=False,
        effects={"diffuse_pairs": "off", "wideband": "off"},
    )  # no rays of theirs, one launch a block
    made, rays = _blocks(replace(scene, settings=settings))
    traced = []
    launch = Tracer.launch

    def counted(self, one, *args):
        traced.append(one.part.rays)
        return launch(self, one, *args)

    monkeypatch.setattr(Tracer, "launch", counted)  # of every band
    before = made.interval
    made.settle()
    each = sum(grid.n_rays for grid in rays.at(0)[0])
    assert made.interval == before
    more = sum(traced) / each - 2.0
    # one pulse for the growth of the error; all rays once more, and shifted; blocks have an
    # error of their own, which is not the rays'
    assert more == pytest.approx(3.0) if not strips else 1.0 < more < 1.25
