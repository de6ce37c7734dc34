"""Waves between metal bodies: which bodies have them, how they fall off, and gaps between faces."""

from itertools import pairwise

import numpy as np
import pytest
import trimesh

from sarmitsuba.core.arrays import F64
from sarmitsuba.effects import waves_between as module
from sarmitsuba.effects.omitted_waves import BENT, SimulatedWaves, metal_lines, omitted_energy
from sarmitsuba.effects.theory_error import repeated_share
from sarmitsuba.effects.waves_between import gaps, metal_faces, waves_between

CHANNELS = ("HH", "VV")
LONG = 40.0


def sheet(*places: tuple[float, float]) -> F64:
    """Triangles of an outline in x and y, drawn out along z."""
    quads = [
        np.array([[*p, z] for p, z in ((a, -1), (b, -1), (b, 1), (a, 1))], dtype=float)
        for a, b in pairwise(places)
    ]
    return np.array([q[i] * [1.0, 1.0, 0.5 * LONG] for q in quads for i in ([0, 1, 2], [0, 2, 3])])


def box(x: float, size: float = 2.0, y: float = 0.0) -> F64:
    return np.asarray(trimesh.creation.box((size, size, size)).triangles + np.array([x, y, 0.0]))


def around(n: int = 36) -> F64:
    azimuth = 2.0 * np.pi * (np.arange(n) + 0.37) / n
    return np.stack([np.cos(azimuth), np.sin(azimuth), 0.0 * azimuth], axis=1)


def energy(corners: F64, looks: F64 | None = None, wavelength: float = 1.0) -> F64:
    looks = around() if looks is None else looks
    lines = metal_lines(corners, np.ones(len(corners)), wavelength)
    return waves_between(lines, metal_faces(corners), looks, CHANNELS, wavelength).energy


def test_one_body_has_none_and_neither_have_bodies_that_touch() -> None:
    assert not energy(box(0.0)).any()
    rng = np.random.default_rng(29)
    apart = rng.permutation(np.concatenate([box(0.0), box(3.0)]))
    assert energy(apart).min(axis=0).max() > 0.0
    # a sheet that stands on another one, without a common edge
    foot = np.concatenate([sheet((0, -4), (0, 4)), sheet((0, 1), (3, 1))])
    assert not energy(foot).any()
    assert energy(np.concatenate([sheet((0, -4), (0, 4)), sheet((0.3, 1), (3, 1))])).any()


def test_a_box_in_loose_triangles_is_one_body() -> None:
    corners = box(0.0)
    moved = corners + 1e-9 * np.random.default_rng(1).normal(size=(len(corners), 1, 3))
    assert not energy(moved).any()


@pytest.mark.parametrize("seed", range(4))
def test_closed_form_of_a_narrow_sheet_far_above_a_wide_one(seed: int) -> None:
    """Both rims of the upper sheet over the mirror: 1.1 or 1.3 over the sine of the angle to the normal."""
    rng = np.random.default_rng([seed, 29])
    height, angle = rng.uniform(3.0, 6.0), rng.uniform(0.3, 0.6) * rng.choice([-1.0, 1.0])
    upper = sheet((height, -0.7), (height, 0.7))
    corners = np.concatenate([sheet((0.0, -300.0), (0.0, 300.0)), upper])
    look = np.array([[np.cos(angle), np.sin(angle), 0.0]])
    # the upper sheet lies over the mirror's middle: of the lower one's rims nothing comes back by way of the upper one
    sine = abs(np.sin(angle))
    found = energy(corners, look)[0]
    rims = 2.0 * LONG**2 / np.pi * np.minimum(1.0 / sine, 2.0 * np.pi * 1.4) ** 2
    # edges of the one lit by those of the other, with the field along them, hundreds of wavelengths away
    # tol: ends of the sheets, whose waves spread along their planes
    assert found[0] == pytest.approx(1.1**2 * rims, rel=0.06)
    assert found[1] == pytest.approx(1.3**2 * rims, rel=0.06)


def test_waves_fall_off_with_distance() -> None:
    near, far, farther = (
        energy(np.concatenate([box(0.0), box(2.0 + gap)])).mean(axis=0) for gap in (0.5, 20.0, 200.0)
    )
    assert (near > 3.0 * far).all() and (far > 3.0 * farther).all()


def test_the_gap_is_said() -> None:
    corners = np.concatenate([sheet((0, -4), (0, 4)), sheet((0.6, -4), (0.6, 4))])
    lines = metal_lines(corners, np.ones(len(corners)), 1.0)
    found = waves_between(lines, metal_faces(corners), around(), CHANNELS, 1.0)
    assert found.gap == pytest.approx(0.6, rel=0.05)


def test_work_is_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    corners = np.concatenate([box(4.0 * i, 1.0, 4.0 * j) for i in range(12) for j in range(12)])
    faces = metal_faces(corners)
    assert faces.n == 864 and faces.body.max() == 143 and faces.closed.all()
    lines = metal_lines(corners, np.ones(len(corners)), 1.0)
    row, place, weight = module._points(lines)
    assert len(place) == module.MOST_POINTS
    # the points stand for all lines
    assert (weight * lines.length[row]).sum() == pytest.approx(lines.length.sum(), rel=1e-9)
    point, face = module._near(place, faces)
    assert len(point) == len(face) == len(place) * (module.MOST_FACES + module.NEAREST)
    whole = waves_between(lines, faces, around(8), CHANNELS, 1.0).energy.mean()
    monkeypatch.setattr(module, "MOST_PRODUCTS", 8 * 8000)
    # those with the largest solid angles are most of it
    assert 0.4 < waves_between(lines, faces, around(8), CHANNELS, 1.0).energy.mean() / whole <= 1.0


def test_faces_are_rectangles_and_boxes_have_outward_normals() -> None:
    for sign in (1.0, -1.0):
        corners = box(0.0, 3.0)[:, :: int(sign)]
        faces = metal_faces(corners)
        assert faces.n == 6 and np.allclose(faces.half, 1.5) and np.allclose(faces.fill, 1.0)
        assert np.allclose(np.einsum("fi,fi->f", faces.center, faces.axes[:, 2]), 1.5)


def test_gaps_of_channels_and_of_boxes() -> None:
    channel = metal_faces(sheet((5, 0), (0, 0), (0, 0.5), (5, 0.5)))
    assert np.sort(gaps(channel))[:2] == pytest.approx([0.5, 0.5]) and np.isinf(gaps(channel)).sum() == 1
    assert np.isinf(gaps(metal_faces(box(0.0)))).all()
    two = gaps(metal_faces(np.concatenate([box(0.0), box(3.0)])))
    assert np.isfinite(two).sum() == 2 and two.min() == pytest.approx(1.0)


def test_repeated_bounces_in_a_narrow_channel_are_doubted() -> None:
    corners = sheet((8, 0), (0, 0), (0, 0.5), (8, 0.5))
    share = repeated_share(metal_faces(corners), 4.0, 1.0, 4)
    area = 2.0 * 8.0 + 0.5
    # sides half a wavelength apart, and the base by its width of four wavelengths
    assert share == pytest.approx(
        [0.0, *(16.0 / area + 0.5 / area * np.square(n / 4.0) for n in (1.0, 2.0, 3.0))]
    )


def test_waves_along_bent_sheets() -> None:
    """With the electric field across the rims, all round, the less the sharper the bend; plane sheets have none."""

    def bent(angle: float) -> F64:
        corners = sheet((0.0, -5.0), (0.0, 0.0), (5.0 * np.sin(angle), 5.0 * np.cos(angle)))
        lines = metal_lines(corners, np.ones(len(corners)), 1.0)
        return omitted_energy(lines, around(), CHANNELS, 1.0, SimulatedWaves(between_rims=True))[BENT]

    assert not bent(0.0).any()
    gentle, sharp, square = (bent(np.radians(a)) for a in (12.0, 50.0, 90.0))
    assert (gentle[:, 0] > 100.0 * gentle[:, 1]).all() and gentle[:, 0].min() > 0.1 * LONG**2 / np.pi
    assert (sharp[:, 0] < 0.5 * gentle[:, 0]).all() and square.max() < 1e-9
