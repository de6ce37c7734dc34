"""Sections of folds between metal faces: found, solved by moments, followed by rays, tabulated, measured."""

import numpy as np
import pytest

from sarmitsuba.core.constants import SPEED_OF_LIGHT
from sarmitsuba.effects.fold_sections import (
    MeasuredFold,
    find_folds,
    fold_error,
    fold_grids,
    section_by_moments,
    section_by_rays,
)
from sarmitsuba.effects.omitted_waves import metal_lines
from sarmitsuba.effects.theory_error import remove_folds
from sarmitsuba.simulation.execution.rcs import monostatic_rcs
from sarmitsuba.truth import theory
from sarmitsuba.truth.validation import targets


def ends_of(angle: float, width: np.ndarray) -> list[np.ndarray]:
    """Far ends of two strips whose bisector is x."""
    return [
        w * np.array([np.cos(t), np.sin(t)]) for w, t in zip(width, (-0.5 * angle, 0.5 * angle), strict=True)
    ]


def bent_plate(angle: float, width: np.ndarray, length: float, cuts: int = 1) -> np.ndarray:
    """Triangles (n, 3, 3) of two rectangles that meet along z, each cut into ``cuts`` times ``cuts`` parts."""
    triangles = []
    grid = np.arange(cuts) / cuts
    for end in ends_of(angle, width):
        a, b = np.array([*end, 0.0]) / cuts, np.array([0.0, 0.0, length / cuts])
        for u in grid:
            for v in grid:
                p = np.array([*(u * end), (v - 0.5) * length])
                triangles += [[p, p + a, p + a + b], [p, p + a + b, p + b]]
    return np.array(triangles)


@pytest.mark.parametrize(("angle", "width"), [(60.0, (2.0, 3.0)), (105.0, (2.0, 4.0)), (140.0, (1.0, 2.0))])
def test_sections_by_moments_are_those_of_the_theory(angle: float, width: tuple[float, float]) -> None:
    turn, wide = np.radians(angle), np.array(width)
    azimuth = np.radians(np.arange(-170.0, 180.0, 23.0))
    exact = theory.strips_by_moments([[ends_of(turn, wide)[0], [0, 0], ends_of(turn, wide)[1]]], 1.0, azimuth)
    found = section_by_moments(turn, wide, 1.0, azimuth)
    # tol: segments of equal length against shorter ones at the ends, where currents are infinite
    assert np.abs(found - exact).max() < 0.02 * np.abs(exact).max()


@pytest.mark.parametrize(("angle", "width"), [(80.0, (6.0, 6.0)), (90.0, (5.0, 3.0)), (110.0, (4.0, 7.0))])
def test_sections_by_rays_are_those_of_the_simulator(angle: float, width: tuple[float, float]) -> None:
    turn, wide, length = np.radians(angle), np.array(width), 2.0
    azimuth = np.radians(np.arange(-50.0, 51.0, 9.0) + 0.3)
    faces = [targets.parallelogram([0, 0, 0], [*end, 0.0], [0, 0, length]) for end in ends_of(turn, wide)]
    got = monostatic_rcs(
        targets.geometry(faces), targets.PEC, targets.from_azimuth(azimuth), SPEED_OF_LIGHT, ray_spacing=0.1
    )
    rays = section_by_rays(turn, wide, 1.0, azimuth, edges=False)
    for values, channel in zip(rays, ("VV", "HH"), strict=True):
        level = 10.0 ** (0.05 * got.rcs_dbsm(channel)) / (length * np.sqrt(2.0))
        # tol: rays a tenth of a wavelength apart, whose tubes are not cut where the reflected beam ends
        assert np.abs(np.abs(values) - level).max() < 0.03 * level.max()


def test_folds_do_not_depend_on_how_faces_are_cut() -> None:
    turn, width = np.radians(105.0), np.array([3.0, 4.0])
    for cuts in (1, 3, 40):
        folds = find_folds(bent_plate(turn, width, 5.0, cuts), 1.0)
        assert folds.n == 1 and folds.plain.all() and not folds.square.any()
        assert np.sort(folds.width[0]) == pytest.approx(width)
        assert folds.angle[0] == pytest.approx(turn) and folds.length[0] == pytest.approx(5.0)
    # one face in halves whose sides are cut elsewhere than those of the other
    halves = np.concatenate([bent_plate(turn, width, 5.0, 1)[:2], bent_plate(turn, width, 5.0, 3)[18:]])
    assert find_folds(halves, 1.0).plain.tolist() == [True]


def test_folds_of_three_plates_and_of_touching_ones_are_told_apart() -> None:
    square = np.array([[0.0, 0, 0], [3, 0, 0], [3, 3, 0], [0, 3, 0]])
    sides = [np.roll(square, i, axis=1) for i in range(3)]
    trihedral = np.array([[s[i] for i in ids] for s in sides for ids in ((0, 1, 2), (0, 2, 3))])
    folds = find_folds(trihedral, 1.0)
    assert folds.n == 3 and folds.square.all() and not folds.plain.any()
    # a wall in the middle of a floor, without common points: two folds
    wall = square[:, [2, 1, 0]] + [1.4, 0.0, 0.0]
    quads = (square, wall)
    folds = find_folds(np.array([[q[i] for i in ids] for q in quads for ids in ((0, 1, 2), (0, 2, 3))]), 1.0)
    assert folds.n == 2 and not folds.plain.any()
    assert np.sort(folds.width.min(axis=1)) == pytest.approx([1.4, 1.6])


def test_the_outer_side_of_a_body_is_no_fold() -> None:
    corners = np.array([[x, y, z] for x in (0.0, 2) for y in (0.0, 2) for z in (0.0, 2)])
    quads = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
    box = np.array([corners[[q[i] for i in ids]] for q in quads for ids in ((0, 1, 2), (0, 2, 3))])
    assert find_folds(box, 1.0).n == 0


def test_the_witness_of_a_fold_is_measured_and_its_law_is_that_of_right_angles() -> None:
    looks = targets.from_azimuth(np.radians(np.arange(-40.0, 41.0, 5.0)))
    measured = {}
    for angle in (90.0, 105.0):
        folds = find_folds(bent_plate(np.radians(angle), np.array([4.0, 4.0]), 4.0), 1.0)
        for grids in ([], fold_grids(folds, 1.0, looks)):
            found = fold_error(folds, grids, looks, ("HH", "VV"), 1.0)
            assert found.witness is not None and not found.witness.contradicts
            measured[angle, len(grids)] = found.witness
    assert measured[90.0, 0].law_db == pytest.approx(-20.0 * np.log10(4.0))
    # rays miss much of the section off right angles, and what is tabulated has it
    assert measured[105.0, 0].error_db > -15.0 > -30.0 > measured[105.0, 1].error_db
    assert "finer mesh" in measured[105.0, 1].reference


def test_sections_of_wide_faces_are_scaled_down_and_said_so() -> None:
    folds = find_folds(bent_plate(np.radians(110.0), np.array([300.0, 200.0]), 50.0), 1.0)
    looks = targets.from_azimuth(np.radians([-10.0, 0.0, 20.0]))
    assert not fold_grids(folds, 1.0, looks)
    found = MeasuredFold.of(folds, 0, 1.0, np.array([0.1]), tabulated=False, edges=True)
    assert found.scale == pytest.approx(30.0 / 500.0)
    assert "0.06 times its width" in found.witness(np.nan).reference


def test_lines_beside_a_solved_fold_keep_their_ends_alone() -> None:
    corners = bent_plate(np.radians(105.0), np.array([3.0, 4.0]), 5.0)
    lines = metal_lines(corners, np.ones(len(corners)), 1.0)
    kept = remove_folds(lines, find_folds(corners, 1.0))
    upright = np.abs(lines.along[:, 2]) > 0.5
    assert upright.sum() == 3 and np.isinf(kept.width[upright]).all()
    assert np.array_equal(kept.width[~upright], lines.width[~upright])
