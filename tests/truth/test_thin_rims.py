"""Rims of thin plates: what is found, and the closed form of a thick rim against strips solved numerically."""

import numpy as np
import pytest
import trimesh

from sarmitsuba.core.arrays import C128, F64, I64
from sarmitsuba.scene.mesh import sharp_edges as thin_rims
from sarmitsuba.scene.mesh.sharp_edges import (
    ELECTRIC,
    ONE_EDGE,
    SharpEdges,
    replace_thin_rims,
    sharp_edges,
    wedge_shares,
)
from sarmitsuba.tracing.scatterers.edges.diffraction import edges_of
from sarmitsuba.truth import theory
from sarmitsuba.truth.theory.moments import strips_by_moments
from sarmitsuba.truth.validation import targets


def edges_of_box(size: F64, *, divided: int = 0, turn: F64 | None = None) -> SharpEdges:
    """Sharp edges of a box, its faces divided, placed anywhere."""
    box = trimesh.creation.box(extents=size)
    for _ in range(divided):
        box = box.subdivide()
    if turn is not None:
        box.apply_transform(turn)
    corners = np.asarray(box.vertices)[box.faces]
    return sharp_edges(corners, np.ones(len(corners), dtype=bool))


@pytest.mark.parametrize("seed", range(3))
def test_neighbours_of_edges_of_all_lengths_are_those_of_brute_force(
    seed: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Edges from millimetres to 30 m, half of them of thin boxes."""
    rng = np.random.default_rng(seed)
    corners = []
    for i in range(80):
        size = 10.0 ** rng.uniform(-1.5, 1.5, 3)
        if i % 2:
            size[rng.integers(3)] = 10.0 ** rng.uniform(-4.0, -2.3)
        box = trimesh.creation.box(extents=size)
        box.apply_transform(trimesh.transformations.random_rotation_matrix(rng.uniform(size=3)))
        box.apply_translation(rng.uniform(-30.0, 30.0, 3))
        corners.append(np.asarray(box.vertices)[box.faces])
    triangles = np.concatenate(corners)
    edges = sharp_edges(triangles, np.ones(len(triangles), dtype=bool))

    def everyone(_: SharpEdges, rows: I64, __: float) -> I64:
        return rows[np.stack(np.triu_indices(rows.size, 1))]

    found = replace_thin_rims(edges, 0.03)
    monkeypatch.setattr(thin_rims, "_near", everyone)
    expected = replace_thin_rims(edges, 0.03)
    assert (found.thickness > 0.0).sum() > 100
    assert np.array_equal(found.middle, expected.middle)


@pytest.mark.parametrize("seed", range(6))
def test_rims_of_drawn_plates_in_any_place(seed: int) -> None:
    """Four rims round the plate's middle plane; its four short edges stay wedges."""
    rng = np.random.default_rng(seed)
    turn = trimesh.transformations.random_rotation_matrix(rng.uniform(size=3))
    turn[:3, 3] = rng.uniform(-5.0, 5.0, 3)
    size = np.append(rng.uniform(0.5, 3.0, 2), rng.uniform(0.002, 0.03))
    found = replace_thin_rims(edges_of_box(size, divided=seed % 3, turn=turn), 1.0)
    rims = found.of(found.thickness > 0.0)
    assert (rims.angle == 2.0).all()
    assert rims.length.sum() == pytest.approx(2.0 * size[:2].sum(), rel=1e-9)
    assert rims.thickness == pytest.approx(np.full(rims.n, size[2]), rel=1e-6)
    place = (rims.middle - turn[:3, 3]) @ turn[:3, :3]
    assert np.abs(place[:, 2]).max() < 1e-9
    # in the narrow faces, inward towards the middle, frames right-handed and orthonormal
    assert np.abs(np.abs(place[:, :2]) / (0.5 * size[:2]) - 1.0).min(axis=1).max() < 1e-9
    assert (np.einsum("ni,ni->n", rims.inward[:, 0] @ turn[:3, :3], place) < 0.0).all()
    assert np.linalg.norm(rims.along, axis=1) == pytest.approx(np.ones(rims.n))
    assert np.array_equal(rims.normal[:, 0], -rims.normal[:, 1])
    rest = found.of(found.thickness == 0.0)
    assert (rest.parts == 1.0).all() and rest.length.sum() == pytest.approx(4.0 * size[2], rel=1e-9)


def test_parts_of_rims_and_wedges_add_up() -> None:
    for thickness in np.linspace(0.005, 0.25, 30):
        found = replace_thin_rims(edges_of_box(np.array([1.3, 2.0, thickness])), 1.0)
        shares = wedge_shares(np.array([thickness]))[0]
        length = [float((x.parts[:, i] * x.length).sum()) for x in (found,) for i in (0, 1)]
        # two wedges or one rim for each of the four sides
        assert length == pytest.approx((1.0 + shares) * 6.6 + 4.0 * thickness)
    assert not (
        replace_thin_rims(edges_of_box(np.array([1.3, 2.0, 1.01 * ONE_EDGE])), 1.0).thickness > 0.0
    ).any()


def test_a_longer_neighbour_keeps_what_the_rim_does_not_cover() -> None:
    """A plate with a step: the wedge beside the step goes on without a partner."""
    outline = np.array([[0, 0], [2, 0], [2, 0.02], [1, 0.02], [1, 0.5], [0, 0.5]])
    low, high = (np.column_stack([outline, np.full(6, z)]) for z in (0.0, 1.5))
    i = np.arange(6)
    j = np.roll(i, -1)
    cap = np.array([[0, 1, 3], [1, 2, 3], [0, 3, 5], [3, 4, 5]])
    faces = np.concatenate(
        [cap[:, ::-1], cap + 6, np.column_stack([i, j, j + 6]), np.column_stack([i, j + 6, i + 6])]
    )
    corners = np.concatenate([low, high])[faces]
    found = replace_thin_rims(sharp_edges(corners, np.ones(len(corners), dtype=bool)), 1.0)
    rims = found.of(found.thickness > 0.0)
    # the end of the thin part, and its two sides of one unit
    assert np.sort(rims.length) == pytest.approx([1.0, 1.0, 1.5])
    lower = (found.thickness == 0.0) & (np.abs(found.middle[:, 1]) < 1e-9) & (np.abs(found.along[:, 0]) > 0.9)
    assert found.length[lower] == pytest.approx([1.0, 1.0])
    assert found.middle[lower, 0] == pytest.approx([0.5, 0.5])


def test_thin_bars_and_wedges_of_other_angles_stay() -> None:
    bar = replace_thin_rims(edges_of_box(np.array([0.03, 0.04, 2.0])), 1.0)
    assert bar.length[bar.thickness > 0.0].max() < 0.05
    assert bar.parts[bar.length > 1.0].min() == 1.0
    tapered = trimesh.creation.box(extents=[1.0, 2.0, 0.02])
    tapered.vertices[tapered.vertices[:, 2] > 0, :2] *= 0.98
    corners = np.asarray(tapered.vertices)[tapered.faces]
    assert not replace_thin_rims(sharp_edges(corners, np.ones(len(corners), dtype=bool)), 1.0).thickness.any()


def test_a_plate_on_its_ground_has_rims_where_nothing_touches() -> None:
    """Three of the four rims of an upright plate: the ground covers the lowest."""
    plate = trimesh.creation.box(extents=[0.02, 2.0, 1.0])
    plate.apply_translation([0.0, 0.0, 0.5])
    ground = targets.parallelogram([-4, -4, 0], [8, 0, 0], [0, 8, 0])
    both = targets.geometry(
        [(np.asarray(plate.vertices), np.asarray(plate.faces, dtype=np.int32)), ground], [0, 1]
    )
    found = edges_of(both, (targets.PEC[0], targets.BLACK), 1.0)
    rims = found.of(found.thickness > 0.0)
    assert rims.length.sum() == pytest.approx(4.0, rel=0.01)
    assert rims.middle[:, 2].min() > 0.0
    # the sheet behind the upright ones is as wide as the plate
    upright = np.abs(rims.along[:, 2]) > 0.9
    assert rims.span[upright][:, 7:9].min() == pytest.approx(2.0 / np.cos(np.pi / 32.0), rel=0.02)


def solved(width: float, thickness: float, angle: F64) -> C128:
    """Amplitudes of a box, electric field along and across its axis, over the edge-on amplitude of an edge."""
    a, b = 0.5 * thickness, 0.5 * width
    outline = [(a, -b), (a, b), (-a, b), (-a, -b), (a, -b)]
    return np.asarray(strips_by_moments([outline], 1.0, angle)) * np.sqrt(2.0 * np.pi)


@pytest.mark.parametrize("seed", range(4))
def test_a_displaced_half_plane_is_the_thick_rim(seed: int) -> None:
    """Field along the rims of drawn plates, random angles up to edge-on, against the method of moments."""
    rng = np.random.default_rng(seed)
    width, thickness = rng.uniform(1.5, 5.0), rng.uniform(0.004, 0.03)
    angle = np.radians(rng.uniform(1.0, 89.9, 40))
    exact = np.abs(solved(width, thickness, angle)[0])
    thin, sheet = (
        np.sqrt(np.pi * closed(width, 1.0, *rest, 1.0, angle)[0]) - exact
        for closed, rest in ((theory.thin_plate, (thickness,)), (theory.plate_along_its_sheet, ()))
    )
    # tol: of the second order in the thickness, 40 t^2, and waves between the rims, 0.01
    assert np.sqrt(np.mean(thin**2)) < 0.01 + 40.0 * thickness**2
    # what lies off the sheet's plane is not seen in the levels of a sheet in the middle
    assert np.sqrt(np.mean(sheet**2)) > 2.0 * np.sqrt(np.mean(thin**2))


def test_blending_is_where_rims_and_wedges_err_alike() -> None:
    """Field along the edges, boxes a little thinner and thicker than the blending."""
    angle = np.radians(np.linspace(1.0, 89.0, 45))
    k = 2.0 * np.pi

    def wedges(width: float, thickness: float) -> C128:
        total = np.zeros(angle.size, dtype=np.complex128)
        for i, t in enumerate(angle):
            look = np.array([np.cos(t), np.sin(t), 0.0])
            for normal, along, off in (
                ((1, 0, 0), (0, width, 0), (0.5 * thickness, 0, 0)),
                ((0, 1, 0), (thickness, 0, 0), (0, 0.5 * width, 0)),
            ):
                size = float(np.linalg.norm(along))
                total[i] += (
                    2.0 * np.sqrt(np.pi) * size * (look @ normal) * np.sinc(2.0 * (look @ along))
                ) * np.exp(2j * k * (look @ off))
            for sx, sy in ((1, 1), (1, -1), (-1, 1)):
                wedge = theory.WedgeFrame(1.5, np.array([0.0, -sy, 0.0]), np.array([sx, 0.0, 0.0]))
                place = np.array([0.5 * sx * thickness, 0.5 * sy * width, 0.0])
                e = np.array([0.0, 0.0, 1.0])
                total[i] += theory.fringe_strip(wedge, look, look, e, e) * np.exp(2j * k * (look @ place))
        return total * np.sqrt(np.pi)

    errors = []
    for thickness in (0.5 * ELECTRIC[0], 1.5 * ELECTRIC[1]):
        square = np.zeros(2)
        for width in (1.7, 2.9, 4.4):
            exact = np.abs(solved(width, thickness, angle)[0])
            rim = np.sqrt(np.pi * theory.thin_plate(width, 1.0, thickness, 1.0, angle)[0])
            two = np.abs(wedges(width, thickness))
            square += [np.mean((rim - exact) ** 2), np.mean((two - exact) ** 2)]
        errors.append(np.sqrt(square / 3.0))
    (thin_rim, thin_wedges), (thick_rim, thick_wedges) = errors
    assert thin_rim < 0.5 * thin_wedges
    assert thick_wedges < 0.5 * thick_rim
