"""The stored exact solutions: checked against closed forms, symmetry and, where it is installed, their solver."""

import json
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from sarmitsuba.core.errors import OutputError
from sarmitsuba.core.units import db_from_power
from sarmitsuba.truth import theory
from sarmitsuba.truth.validation import full_wave


@pytest.fixture
def solver(benchmark_script: Callable[[str], ModuleType]) -> ModuleType:
    module = benchmark_script("full_wave_solver")
    if not module.installed():
        pytest.skip("bempp-cl or pyopencl is not installed: pip install '.[full-wave]'")
    return module


def cut(name: str, index: int) -> tuple[full_wave.DirectionCut, full_wave.C128]:
    chosen = full_wave.SCENES[name].cuts[index]
    return chosen, full_wave.read_stored()[name][chosen.name]


def test_the_stored_double_bounce_is_the_textbook_one() -> None:
    """Level of the box's wall on its ground: no simulator in between, so that both references vouch for each other."""
    along, s = cut("box", 2)
    assert (along.axis, along.fixed) == ("elevation", 0.0)
    steep = along.angle <= 50.0
    closed = theory.wall_ground_amplitude(
        full_wave.BOX_HEIGHT, full_wave.BOX_Y, 1e3, 1.0, np.radians(90.0 - along.angle[steep])
    )
    for i, want in zip((0, 2), closed, strict=True):
        off = db_from_power(np.abs(s[steep, i]) ** 2) - db_from_power(np.abs(want) ** 2)
        # tol: edge waves of a wall of 4 wavelengths, a fifth of a lobe's field at most, cancel over the cut
        assert abs(np.mean(off)) < 0.3
        assert np.abs(off).max() < 1.5
        # tol: the same, as a phase; both are referred to the foot of the wall, which is half the box from its centre
        shift = np.exp(-2j * np.pi * full_wave.BOX_X * np.cos(np.radians(along.angle[steep])))
        assert np.abs(np.angle(s[steep, i] * shift / want)).max() < np.radians(20.0)


def test_planes_of_symmetry_do_not_turn_the_polarisation() -> None:
    """Solved without that symmetry in the excitation: HV there is what rounding and the mesh leave."""
    for name, index in (("corner", 2), ("box", 2), ("cylinder", 2)):
        _, s = cut(name, index)
        # tol: single precision, four decimals stored
        assert np.abs(s[:, 1]).max() < 1e-3 * np.abs(s[:, 0]).max()


def test_the_mesh_is_fine_enough() -> None:
    """Triangles of a sixth and of an eighth of a wavelength agree within 20 dB of the peak."""
    corner = json.loads(full_wave.STORED.read_text(encoding="utf-8"))["corner"]
    (coarse,) = corner["coarser_mesh"]
    assert (corner["legs_per_wavelength"], coarse["legs_per_wavelength"]) == (8, 6)
    for errors in coarse["rms_difference_db"].values():
        assert max(errors["HH 20"], errors["VV 20"]) < 0.1


def test_a_reference_with_a_cut_missing_is_refused(tmp_path: Path) -> None:
    given = json.loads(full_wave.STORED.read_text(encoding="utf-8"))
    name, lost = "box", full_wave.SCENES["box"].cuts[1].name
    given[name]["amplitude"][lost].pop()
    path = tmp_path / "short.json"
    path.write_text(json.dumps(given), encoding="utf-8")
    with pytest.raises(OutputError, match=rf"short.json: scene 'box', {lost}: \(90, 6\) numbers instead"):
        full_wave.read_stored(path)


def test_bands_are_of_the_exact_level() -> None:
    exact = np.array([10.0, 8.0, 5.0, 1.0, 0.2], dtype=complex)  # 0, -1.9, -6, -20 and -34 dB
    found = full_wave.bands(exact, exact * np.array([1.0, 2.0, 1.0j, 0.5, 0.0]))
    assert [(b.near, b.far, b.n) for b in found] == [(0, 3, 2), (3, 10, 1), (20, 30, 1), (30, 80, 1)]
    assert found[0].mean_db == pytest.approx(10 * np.log10((100 + 256) / 164))
    assert found[0].rms_db == pytest.approx(20 * np.log10(2) / np.sqrt(2))
    assert found[1].mean_db == pytest.approx(0.0)
    assert found[2].mean_db == found[2].rms_db * -1 == pytest.approx(20 * np.log10(0.5))
    assert found[3].mean_db < -100.0


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")  # the packages' own, of names that they take from elsewhere
def test_the_solver_meets_the_mie_series(solver: ModuleType) -> None:
    """Sphere with and without a sheet inside; splitting by symmetry and mirror images against the plain problem."""
    bare, lined, split = (value for _, value in solver.check())
    # tol: triangles of an eighth of a wavelength lie inside the sphere, 0.1 dB
    assert bare < 0.2 and lined < 0.2
    assert abs(bare - lined) < 0.02  # what the metal hides does not show
    assert split < -80.0  # single precision
