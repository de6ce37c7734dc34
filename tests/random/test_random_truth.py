"""A part of benchmarks/random_truth.py: drawn scenes against brute force that shares no code with the simulator."""

import importlib
from pathlib import Path
from types import ModuleType

import pytest

BENCHMARKS = Path(__file__).parents[2] / "benchmarks"

# drawn, not chosen: consecutive seeds, less the diffuse ones whose few cells want dozens of runs
METAL = range(70, 82)
DIFFUSE = (1, 6, 11)


@pytest.fixture
def truth(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    monkeypatch.syspath_prepend(str(BENCHMARKS))
    return importlib.import_module("random_truth")


@pytest.mark.parametrize("seed", METAL)
def test_metal_bodies_return_what_physical_optics_says(truth: ModuleType, tmp_path: Path, seed: int) -> None:
    result = truth.run("metal", seed, tmp_path)
    # tol: tubes end at true outlines; curved bodies at 4.5 rays per wavelength keep 0.3 dB
    assert abs(result.level_db) < 0.5, result
    assert result.coherence > 0.98, result


@pytest.mark.parametrize("seed", DIFFUSE)
def test_rough_bodies_return_sigma0_times_their_lit_area(
    truth: ModuleType, tmp_path: Path, seed: int
) -> None:
    result = truth.run("diffuse", seed, tmp_path)
    # tol: 0.2 dB for the lattice of rays at outlines, and three standard errors of the speckle's mean
    assert abs(result.level_db) < 0.2 + 3.0 * result.sigma_db, result
