"""DrawnValue recipes: nothing touches, parts share nothing, relief has its statistics."""

from itertools import combinations
from pathlib import Path

import numpy as np
import pytest
import shapely

from sarmitsuba.apps.dataset_draw import Drawer
from sarmitsuba.apps.dataset_recipe import PART_NAMES
from sarmitsuba.apps.dataset_shapes import hull, lowest_under, relief, separation
from sarmitsuba.core.errors import DataError, SarmitsubaError, SceneError


def drawer_of(tmp_path: Path, text: str) -> Drawer:
    path = tmp_path / "r.toml"
    path.write_text(text, encoding="utf-8")
    return Drawer.of(str(path))


def test_separation_is_a_lower_bound_of_the_distance_and_finds_every_touch() -> None:
    rng = np.random.default_rng(3)
    touching = 0
    for _ in range(300):
        first = hull(rng.uniform(-1, 1, (8, 2)))
        second = hull(rng.uniform(-1, 1, (5, 2)) + rng.uniform(-2, 2, 2))
        a, b = shapely.Polygon(first), shapely.Polygon(second)
        found = separation(first, second)
        touching += a.intersects(b)
        # tol: rounding in float64
        assert (found > 0.0) == (not a.intersects(b))
        assert found <= a.distance(b) + 1e-12 if found > 0.0 else a.distance(b) == 0.0
    assert 30 < touching < 270


@pytest.mark.parametrize("seed", range(4))
def test_shapes_of_drawn_scenes_keep_their_gap(tmp_path: Path, seed: int) -> None:
    rng = np.random.default_rng(seed)
    gap = round(float(rng.uniform(0.0, 1.0)), 3)
    text = f"[dataset]\nsamples = 10\nseed = {seed}\n"
    for name, most in (("objects", 2), ("walls", 3), ("clutter", 6), ("trees", 3)):
        text += f"[{name}]\ncount = {{ uniform = [0, {most}] }}\nspread = 40.0\ngap = {gap}\n"
        text += "heading_deg = { uniform = [0, 360] }\n"
    if seed % 2:
        text += "[ground]\nrelief = 0.3\nrelief_length = 8.0\n"
    drawer = drawer_of(tmp_path, text)
    pairs = 0
    for number in range(10):
        shapes = drawer.draw(number, 0).shapes
        plans = [shapely.Polygon(hull(shape.vertices[:, :2])) for shape in shapes]
        for a, b in combinations(plans, 2):
            pairs += 1
            assert a.distance(b) >= gap - 1e-9  # tol: rounding in float64
    assert pairs > 50


def test_a_scene_without_room_is_refused(tmp_path: Path) -> None:
    drawer = drawer_of(tmp_path, "[objects]\ncount = 30\nspread = 6.0\n")
    with pytest.raises(SceneError, match="no free place"):
        drawer.draw(0, 0)


def test_draws_depend_on_seed_number_and_attempt_alone(tmp_path: Path) -> None:
    text = "[dataset]\nsamples = 9\nseed = {}\n[objects]\nspread = 20.0\n"
    text += "[radar]\nheading_deg = {{ uniform = [0, 300] }}\n"
    drawer = drawer_of(tmp_path, text.format(4))
    first = [drawer.draw(n, 0) for n in range(5)]
    again = drawer_of(tmp_path, text.format(4))
    for one in reversed(first):
        other = again.draw(one.number, 0)
        assert other.facts == one.facts
        assert all(
            np.array_equal(a.vertices, b.vertices) for a, b in zip(one.shapes, other.shapes, strict=True)
        )
        assert other.scene.settings.seed == one.scene.settings.seed
    headings = {d.facts["radar.heading_deg"] for d in first}
    headings |= {drawer.draw(0, 1).facts["radar.heading_deg"]}
    headings |= {drawer_of(tmp_path, text.format(5)).draw(0, 0).facts["radar.heading_deg"]}
    assert len(headings) == 7


def test_views_share_their_scene_and_part(tmp_path: Path) -> None:
    text = "[dataset]\nsamples = 12\nviews = 4\n[objects]\nspread = 20.0\n"
    text += "[radar]\nheading_deg = { uniform = [0, 300] }\n"
    drawer = drawer_of(tmp_path, text)
    for scene in range(3):
        views = [drawer.draw(4 * scene + i, i) for i in range(4)]  # other attempts leave the scene as it is
        assert len({d.part for d in views}) == 1
        assert len({d.facts["radar.heading_deg"] for d in views}) == 4
        assert all(np.array_equal(d.shapes[0].vertices, views[0].shapes[0].vertices) for d in views)


def test_parts_by_instance_share_no_mesh(tmp_path: Path) -> None:
    text = (
        "[dataset]\nsamples = 60\nseed = 2\n[parts]\nby = 'instance'\n[objects]\ncount = 2\nspread = 26.0\n"
    )
    drawer = drawer_of(tmp_path, text)
    seen: dict[str, set[str]] = {name: set() for name in PART_NAMES}
    for number in range(60):
        drawn = drawer.draw(number, 0)
        seen[drawn.part] |= {shape.instance for shape in drawn.shapes}
    assert all(seen.values())
    assert all(not (seen[a] & seen[b]) for a, b in combinations(PART_NAMES, 2))
    for part in PART_NAMES:  # every class in every part
        assert {mesh.semantic_class for mesh in drawer.parts.meshes_of(part)} == {"boat", "vehicle"}


def test_shares_of_parts(tmp_path: Path) -> None:
    drawer = drawer_of(tmp_path, "[parts]\ntrain = 0.5\nvalidation = 0.3\ntest = 0.2\n")
    found = [drawer.parts.of_scene(n) for n in range(4000)]
    for name, share in (("train", 0.5), ("validation", 0.3), ("test", 0.2)):
        # tol: five standard deviations of a binomial share of 4000
        assert abs(found.count(name) / 4000 - share) < 5.0 * np.sqrt(share * (1 - share) / 4000)


def test_a_class_with_too_few_meshes_is_refused(tmp_path: Path) -> None:
    folder = tmp_path / "own" / "lone"
    folder.mkdir(parents=True)
    (folder / "a.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 1 4 3\n")
    drawer = drawer_of(tmp_path, "[parts]\nby = 'instance'\n[objects]\nmeshes = 'own'\n")
    with pytest.raises(DataError, match="class lone has 1 meshes for 3 parts"):
        drawer.draw(0, 0)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("v nan 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "a.obj"),
        ("v 0 0 0\nv 1e9 0 0\nv 0 1 0\nf 1 2 3\n", "extends over 1e+09 m"),
        ("v 0 0 0\nv 0 0 0\nv 0 0 0\nf 1 2 3\n", "extends over 0 m"),
        ("hello", "a.obj"),
    ],
)
def test_bad_meshes_get_one_line(tmp_path: Path, text: str, said: str) -> None:
    (tmp_path / "own").mkdir()
    (tmp_path / "own" / "a.obj").write_text(text)
    with pytest.raises(SarmitsubaError) as caught:
        drawer_of(tmp_path, "[objects]\nmeshes = 'own'\n").draw(0, 0)
    assert said in str(caught.value) and "\n" not in str(caught.value)


def test_plates_on_edge_are_placed(tmp_path: Path) -> None:
    (tmp_path / "own").mkdir()
    (tmp_path / "own" / "a.obj").write_text("v 0 0 0\nv 2 0 0\nv 2 0 1\nv 0 0 1\nf 1 2 3\nf 1 3 4\n")
    text = "[objects]\nmeshes = 'own'\ncount = 6\nspread = 8.0\nheading_deg = { uniform = [0, 360] }\n"
    shapes = drawer_of(tmp_path, text).draw(0, 0).shapes
    lines = [shapely.MultiPoint(shape.vertices[:, :2]).convex_hull for shape in shapes]
    assert all(a.distance(b) >= 0.3 - 1e-9 for a, b in combinations(lines, 2))  # tol: rounding in float64


def test_files_of_the_radar_lie_beside_the_recipe(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    angles = "".join(f"{cut},{a},{-(a**2)}\n" for cut in ("azimuth", "elevation") for a in (-2, -1, 0, 1, 2))
    (tmp_path / "beam.csv").write_text("cut,angle_deg,gain_db\n" + angles)
    monkeypatch.chdir("/")
    text = "[objects]\n[radar]\npattern = 'table'\npattern_file = 'beam.csv'\n"
    assert drawer_of(tmp_path, text).draw(0, 0).scene.radar.antenna.pattern == "table"


def test_relief_has_its_height_and_correlation() -> None:
    rng = np.random.default_rng(8)
    heights = []
    for _ in range(40):
        vertices, faces = relief(100.0, 0.5, 5.0, rng)
        n = round(np.sqrt(len(vertices)))
        heights.append(vertices[:, 2].reshape(n, n))
        assert faces.max() == len(vertices) - 1
    z = np.array(heights)
    step = 100.0 / (z.shape[1] - 1)
    lag = round(5.0 / step)
    # tol: about 40 x 400 independent patches of pi / 2 lengths squared: 1 % rms of the variance, 3 % taken
    assert abs(z.var() / 0.25 - 1.0) < 0.03
    assert abs((z[:, lag:] * z[:, :-lag]).mean() / 0.25 - np.exp(-1.0)) < 0.03


def test_shapes_stand_on_the_lowest_ground_below_them() -> None:
    rng = np.random.default_rng(9)
    ground, _ = relief(40.0, 1.0, 5.0, rng)
    for _ in range(50):
        outline = hull(rng.uniform(-2, 2, (6, 2)) + rng.uniform(-15, 15, 2))
        inside = shapely.contains_xy(shapely.Polygon(outline), ground[:, 0], ground[:, 1])
        assert lowest_under(ground, outline) <= ground[inside, 2].min(initial=np.inf)
