"""The automatic aim point: where geometry is."""

import numpy as np
import pytest
import trimesh

from sarmitsuba import PointTarget, RadarDescription, SceneMesh, build_scene
from sarmitsuba.radar.image_request import Extent
from sarmitsuba.scene.geometry import Geometry


def village(x: float, y: float, houses: int, rng: np.random.Generator) -> list[SceneMesh]:
    places = [(x + dx, y + dy, 4.0) for dx, dy in rng.uniform(-100.0, 100.0, (houses, 2))]
    box = trimesh.creation.box(extents=(10, 10, 8))
    return [
        SceneMesh.of(
            box, "concrete", f"house {x:g} {i}", to_world=trimesh.transformations.translation_matrix(p)
        )
        for i, p in enumerate(places)
    ]


@pytest.mark.parametrize("seed", range(3))
def test_between_two_far_groups_the_larger_is_imaged(seed: int) -> None:
    rng = np.random.default_rng(seed)
    angle, apart = rng.uniform(0.0, 2.0 * np.pi), rng.uniform(8e3, 2e4)
    far = 0.5 * apart * np.array([np.cos(angle), np.sin(angle)])
    scene = build_scene([*village(*far, 4, rng), *village(*-far, 12, rng)])
    middle = np.array([scene.image.center_x, scene.image.center_y]) + scene.offset[:2]
    # tol: 110 m, within the village of 200 m
    assert np.linalg.norm(middle + far) < 110.0
    assert sum("aimed at its densest part" in note for note in scene.notes) == 1


@pytest.mark.parametrize("hilly", [False, True])
@pytest.mark.parametrize("seed", range(3))
def test_ground_between_two_villages_is_not_imaged(seed: int, hilly: bool) -> None:
    """One sheet of ground below both, level or rolling: an image of its middle shows clutter alone."""
    rng = np.random.default_rng(seed)
    angle, apart = rng.uniform(0.0, 2.0 * np.pi), rng.uniform(2e3, 6e3)
    far = 0.5 * apart * np.array([np.cos(angle), np.sin(angle)])
    side = np.linspace(-0.5 * apart - 300.0, 0.5 * apart + 300.0, 41)
    x, y = np.meshgrid(side, side)
    z = 20.0 * np.sin(x / 300.0 + angle) if hilly else np.zeros_like(x)
    corner = (np.arange(40)[:, None] * 41 + np.arange(40)).ravel()
    first, second = (
        np.stack([corner, corner + 1, corner + 42], 1),
        np.stack([corner, corner + 42, corner + 41], 1),
    )
    field = SceneMesh(
        np.stack([x, y, z], axis=-1).reshape(-1, 3), np.concatenate([first, second]), "soil", "field"
    )
    scene = build_scene([field, *village(*far, 4, rng), *village(*-far, 12, rng)])
    middle = np.array([scene.image.center_x, scene.image.center_y]) + scene.offset[:2]
    # tol: 110 m, within the village of 200 m
    assert np.linalg.norm(middle + far) < 110.0
    assert sum("nothing but ground lies in the middle" in note for note in scene.notes) == 1


def test_a_body_in_the_middle_of_wide_ground_stays_there() -> None:
    rng = np.random.default_rng(3)
    field = SceneMesh.of(trimesh.creation.box(extents=(4e3, 4e3, 0.1)), "soil", "field")
    scene = build_scene([field, *village(0.0, 0.0, 1, rng), *village(1500.0, 0.0, 12, rng)])
    assert np.hypot(scene.image.center_x + scene.offset[0], scene.image.center_y + scene.offset[1]) < 1.0
    assert not any("densest" in note for note in scene.notes)


def test_who_aims_is_obeyed_and_points_on_both_sides_stay_in_one_image() -> None:
    rng = np.random.default_rng(5)
    far = [*village(-9e3, 0.0, 4, rng), *village(9e3, 0.0, 12, rng)]
    scene = build_scene(far, radar=RadarDescription(aim_x=-9e3, aim_y=0.0))
    assert abs(scene.radar.aim_point[0] + scene.offset[0] + 9e3) < 1.0
    pair = build_scene(points=[PointTarget(str(x), np.array([x, 0.0, 0.0]), 1.0) for x in (-200.0, 200.0)])
    assert pair.image.center_x == 0.0 and not any("densest" in note for note in pair.notes)


def test_densest_part_is_that_of_brute_force() -> None:
    rng = np.random.default_rng(7)
    for _ in range(20):
        groups, size = rng.uniform(-5e3, 5e3, (4, 2)), 300.0
        counts = rng.permutation([3, 9, 27, 81])
        corners = np.concatenate(
            [
                g + rng.uniform(-60.0, 60.0, (n, 1, 2)) + rng.uniform(-5.0, 5.0, (n, 3, 2))
                for g, n in zip(groups, counts, strict=True)
            ]
        )
        outline = np.concatenate([corners.reshape(-1, 2), np.zeros((3 * len(corners), 1))], axis=1)
        extent = Extent(outline, np.zeros(3), np.arange(len(outline), dtype=np.int32).reshape(-1, 3))
        sides = corners[:, 1:] - corners[:, :1]
        area = 0.5 * np.abs(sides[:, 0, 0] * sides[:, 1, 1] - sides[:, 0, 1] * sides[:, 1, 0])
        near = np.abs(corners.mean(axis=1)[:, None] - groups).max(axis=2) < size
        best = groups[(area[:, None] * near).sum(axis=0).argmax()]
        # tol: 100 m: the middle of what lies in the square, of groups of 130 m
        assert np.abs(extent.densest(size).middle[:2] - best).max() < 100.0
        gap = np.abs(corners.reshape(-1, 2)).max()
        assert not extent.is_empty(np.zeros(2), 2.0 * gap)


def sheet_and_bodies(rng: np.random.Generator, *, sheet: bool, inwards: bool) -> tuple[Geometry, float]:
    """Boxes sunk by drawn depths into a level sheet at a drawn height, or boxes alone; and that height."""
    level = float(rng.uniform(-50.0, 500.0))
    meshes = []
    if sheet:
        x, y = rng.uniform(40.0, 60.0, 2)
        corners = np.array([[-x, -y, level], [x, -y, level], [x, y, level], [-x, y, level]])
        meshes.append((corners, np.array([[0, 1, 2], [0, 2, 3]])))
    for _ in range(2):  # their undersides are more than a quarter of all
        size, depth = rng.uniform(70.0, 90.0, 2), float(rng.uniform(1.0, 6.0))
        box = trimesh.creation.box(extents=(*size, depth + rng.uniform(1.0, 20.0)))
        box.apply_translation([*rng.uniform(-60.0, 60.0, 2), level - depth - box.bounds[0, 2]])
        meshes.append((np.asarray(box.vertices), np.asarray(box.faces)[:, :: -1 if inwards else 1]))
    start = np.cumsum([0, *(len(v) for v, _ in meshes)])
    faces = np.concatenate([f + s for (_, f), s in zip(meshes, start[:-1], strict=True)])
    n = len(faces)
    return Geometry(
        vertices=np.concatenate([v for v, _ in meshes]).astype(np.float32).astype(np.float64),
        faces=faces.astype(np.int32),
        face_material=np.zeros(n, dtype=np.int32),
        face_group=np.arange(n, dtype=np.int32),
        mesh_names=tuple(f"mesh {i}" for i in range(len(meshes))),
        mesh_face_offset=np.cumsum([0, *(len(f) for _, f in meshes)]),
    ), level


@pytest.mark.parametrize("inwards", [False, True])
@pytest.mark.parametrize("seed", range(8))
def test_undersides_below_the_ground_are_not_the_ground(seed: int, inwards: bool) -> None:
    """A quay that reaches below the water: the image plane lay on its underside, and the image beside its place."""
    rng = np.random.default_rng(seed)
    geometry, level = sheet_and_bodies(rng, sheet=True, inwards=inwards)
    assert geometry.ground_height == pytest.approx(level, abs=1e-4)  # tol: float32 corners at 500 m


@pytest.mark.parametrize("seed", range(4))
def test_floors_are_the_ground_where_there_are_bodies_only(seed: int) -> None:
    geometry, level = sheet_and_bodies(np.random.default_rng(seed), sheet=False, inwards=False)
    assert geometry.ground_height < level


def test_a_cone_on_its_base_stands_on_the_ground() -> None:
    """Its base is its only face inclined by less than 45 degrees, and faces down."""
    cone = trimesh.creation.cone(radius=1.0, height=4.0)
    cone.apply_translation([3.0, -2.0, 7.5])
    n = len(cone.faces)
    geometry = Geometry(
        vertices=np.asarray(cone.vertices),
        faces=np.asarray(cone.faces, dtype=np.int32),
        face_material=np.zeros(n, dtype=np.int32),
        face_group=np.arange(n, dtype=np.int32),
        mesh_names=("cone",),
        mesh_face_offset=np.array([0, n]),
    )
    assert geometry.ground_height == 7.5
