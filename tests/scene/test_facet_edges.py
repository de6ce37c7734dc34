"""Returns of single edges: what is left of a smooth facet seen off its glint stands at its edges, whatever the rays."""

from pathlib import Path

import numpy as np
import pytest

from sarmitsuba.loading.load import load_scene
from sarmitsuba.scene.geometry import Geometry
from sarmitsuba.scene.materials.material import Material
from sarmitsuba.scene.mesh.boundary_edges import facets
from sarmitsuba.scene.mesh.smooth_groups import smooth_groups
from sarmitsuba.simulation.execution.rcs import monostatic_rcs
from sarmitsuba.simulation.execution.render import simulate
from tests.support.unweighted import focus

LOOK, WIDTH, DEPTH = 40.0, 2.0, 40.0

SCENE = """<scene version="3.0.0">
<integrator type="sar_path">
  <float name="ray_spacing" value="{spacing}"/>
  <string name="edge_diffraction" value="off"/>
</integrator>
<sensor type="sar_antenna">
  <string name="mode" value="spotlight"/>
  <float name="slant_range" value="10000"/>
  <float name="look_angle_deg" value="{look}"/>
  <float name="center_frequency" value="9.65e9"/>
  <float name="bandwidth" value="500e6"/>
  <float name="azimuth_resolution" value="10"/>
  <string name="polarisation" value="VV"/>
  <film type="range_film">
    <string name="image_grid" value="ground"/>
    <float name="image_extent_azimuth" value="24"/>
    <float name="image_extent_range" value="{extent}"/>
    <float name="pixel_spacing_azimuth" value="1"/>
    <float name="pixel_spacing_range" value="0.05"/>
  </film>
</sensor>
<shape type="rectangle">
  <transform name="to_world"><scale x="{half_depth}" y="{half_width}"/></transform>
  <bsdf type="radar_material"><string name="material" value="pec"/></bsdf>
</shape>
</scene>"""


@pytest.mark.filterwarnings("ignore:plate. ray_spacing = 0.3")
@pytest.mark.filterwarnings("ignore:plate. edge_diffraction is switched off")
@pytest.mark.parametrize("wavelengths", [0.25, 2.5, 4.8, 10.0])
def test_front_and_rear_edge_of_a_plate(tmp_path: Path, wavelengths: float) -> None:
    """A level plate at 40 deg, narrower than a cell: each edge is a point of w^2 / (4 pi tan^2) at its own place."""
    spacing = wavelengths * 0.0310668
    text = SCENE.format(
        spacing=spacing, look=LOOK, extent=DEPTH + 8, half_depth=0.5 * DEPTH, half_width=0.5 * WIDTH
    )
    (tmp_path / "plate.xml").write_text(text, encoding="utf-8")
    image = focus(simulate(load_scene(tmp_path / "plate.xml")))
    theory = WIDTH**2 / (4.0 * np.pi * np.tan(np.radians(LOOK)) ** 2)
    power = np.abs(image.total()) ** 2
    ground = image.grid.positions()[..., 0]
    for edge in (-0.5 * DEPTH, 0.5 * DEPTH):
        near = np.abs(ground - edge) < 2.0
        peak = np.where(near, power, 0.0).argmax()
        # tol: 0.06 dB of the azimuth response over the width, and corners that no ray falls into
        assert abs(10 * np.log10(power.flat[peak] / theory)) < (0.12 if wavelengths < 5 else 0.25)
        assert abs(ground.flat[peak] - edge) <= 0.1  # m; a third of a resolution cell, two pixels


def outline(polygon: list[list[float]], triangles: list[list[int]]) -> np.ndarray:
    points = np.column_stack([np.array(polygon, dtype=float), np.zeros(len(polygon))])
    return points[np.array(triangles)]


def distances(sides: np.ndarray, corners: np.ndarray, point: list[float] | np.ndarray) -> list[float]:
    """From a point of the plane z = 0 to each of a triangle's sides."""
    used = sides[(sides[:, :3] != 0).any(axis=1)]
    place = np.array([*point[:2], 0.0]) - corners[0]
    return sorted(float(d) for d in (used[:, :3] @ place - used[:, 3]).round(6))


@pytest.mark.parametrize(("turn", "shift"), [(0.0, 0.0), (0.7853370, 0.0), (0.3, 1000.0)])
def test_every_triangle_of_a_rectangle_knows_its_four_sides(turn: float, shift: float) -> None:
    """However finely it is cut, wherever it lies: also in float32 a kilometre from the origin."""
    x = np.linspace(0.0, 4.0, 9)
    grid = np.stack([*np.meshgrid(x, 0.5 * x, indexing="ij"), np.zeros((9, 9))], axis=-1).reshape(-1, 3)
    c, s = np.cos(turn), np.sin(turn)
    axes = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
    grid = grid @ axes + [shift, shift, 0.0]
    if shift:
        grid = grid.astype(np.float32).astype(np.float64)
    a = (np.arange(8)[:, None] * 9 + np.arange(8)).ravel()
    faces = np.concatenate([np.column_stack([a, a + 9, a + 10]), np.column_stack([a, a + 10, a + 1])])
    point = np.array([1.0, 0.75, 0.0]) @ axes + [shift, shift, 0.0]
    for side, triangle in zip(facets(grid[faces]).edges, grid[faces], strict=True):
        found = distances(side, triangle, point)
        assert found == pytest.approx([0.75, 1.0, 1.25, 3.0], abs=2e-4)  # m; float32 at 1 km is good to 6e-5


def test_an_l_is_cut_into_convex_parts() -> None:
    """A post 0.2 wide and 8 high with an arm to the right at its top: every point lies in the part of its triangle."""
    polygon = [[0, 0], [0.2, 0], [0.2, 7.8], [1.5, 7.8], [1.5, 8], [0, 8]]
    corners = outline(polygon, [[0, 1, 2], [0, 2, 5], [5, 2, 4], [2, 3, 4]])
    found = facets(corners)
    assert found.closed.all() and len(np.unique(found.part)) == 2
    rng = np.random.default_rng(1)
    for point in rng.random((2000, 2)) * [1.5, 8.0]:
        inside = [
            part
            for part, row in zip(*np.unique(found.part, return_index=True), strict=True)
            if min(distances(found.edges[row], corners[row], point)) > 0.0
        ]
        # where no edge is within rounding
        assert len(inside) == int(point[0] < 0.2 or point[1] > 7.8)


def test_a_lone_triangle_has_three_sides() -> None:
    corners = outline([[0, 0], [1, 0], [0, 1]], [[0, 1, 2]])
    found = distances(facets(corners).edges[0], corners[0], [0.25, 0.25])
    assert found == pytest.approx([0.25, 0.25, np.sqrt(0.125)], abs=1e-5)


@pytest.mark.parametrize("seed", range(4))
def test_boundaries_without_creases_are_those_of_a_smooth_surface(seed: int) -> None:
    """Hills of flat patches: creases below 20 degrees bound the facets only, steps bound both."""
    rng = np.random.default_rng(seed)
    n = 13
    x, y = np.meshgrid(np.arange(n), np.arange(n), indexing="ij")
    height = 0.12 * np.abs((x // 3 + rng.integers(0, 4)) % 5 - 2) * x + 0.3 * rng.random((n, n)) * (y > 7)
    height += 2.0 * (x > 9)
    grid = np.stack([x, y, height], axis=-1).reshape(-1, 3).astype(float)
    a = (x[:-1, :-1] * n + y[:-1, :-1]).ravel()
    faces = np.concatenate([np.column_stack([a, a + n, a + n + 1]), np.column_stack([a, a + n + 1, a + 1])])
    corners = grid[rng.permutation(faces)]
    found = facets(corners, wavelength=0.03)
    smooth = facets(corners, curved=np.ones(len(corners), dtype=bool))
    assert smooth.uncreased is None and found.uncreased is not None
    assert (found.edges != found.uncreased).any() and (found.edges == found.uncreased).all(axis=(1, 2)).any()
    np.testing.assert_array_equal(found.uncreased, smooth.edges)


# m; patterns do not depend on it
WAVELENGTH = 0.03


def pattern(triangles: np.ndarray, look: np.ndarray, *, closed: bool) -> np.ndarray:
    """Physical optics of flat triangles in the far field, m: Gordon's sum over their edges (IEEE TAP 23, 1975)."""
    k = 2.0 * np.pi / WAVELENGTH
    edge = np.roll(triangles, -1, axis=1) - triangles
    normal = np.cross(edge[:, 0], edge[:, 1])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    out = []
    for s in look:
        cosine = normal @ s
        across = 2.0 * k * (s - cosine[:, None] * normal)
        phase = np.einsum("ti,tki->tk", across, triangles + 0.5 * edge)
        half = 0.5 * np.einsum("ti,tki->tk", across, edge)
        turn = np.einsum("ti,tki->tk", np.cross(across, normal), edge)
        ring = (turn * np.exp(1j * phase) * np.sinc(half / np.pi)).sum(axis=1)
        integral = ring / (1j * np.einsum("ti,ti->t", across, across))
        # along the normal the phase is that of the plane
        integral *= np.exp(2j * k * cosine * np.einsum("ti,ti->t", normal, triangles[:, 0]))
        lit = cosine > 0 if closed else np.ones(len(cosine), dtype=bool)
        out.append(k / np.sqrt(np.pi) * np.sum((np.abs(cosine) * integral)[lit]))
    return np.array(out)


def traced(triangles: np.ndarray, look: np.ndarray, spacing: float) -> np.ndarray:
    vertices, faces = np.unique(triangles.reshape(-1, 3), axis=0, return_inverse=True)
    faces = faces.reshape(-1, 3).astype(np.int32)
    n = len(faces)
    geometry = Geometry(
        vertices,
        faces,
        np.zeros(n, np.int32),
        smooth_groups(vertices, faces),
        ("body",),
        np.array([0, n]),
    )
    metal = Material(name="metal", pec=True)
    frequency = 299_792_458.0 / WAVELENGTH
    result = monostatic_rcs(
        geometry, (metal,), look, frequency, channels=("VV",), ray_spacing=spacing, max_depth=1
    )
    return result.amplitude[:, 0, 0]


def gabled(slope_deg: float) -> np.ndarray:
    """Two roof planes and their eaves' ends, open below, 60 wavelengths square."""
    w = 30.0 * WAVELENGTH
    h = w * np.tan(np.radians(slope_deg))
    p = np.array([[-w, -w, 0], [0, -w, h], [w, -w, 0], [-w, w, 0], [0, w, h], [w, w, 0]])
    return p[[[0, 1, 4], [0, 4, 3], [1, 2, 5], [1, 5, 4]]]


def flat(points: list[list[float]], triangles: list[list[int]]) -> np.ndarray:
    return outline((60.0 * WAVELENGTH * np.array(points)).tolist(), triangles)


BODIES = {
    "triangle": flat([[0.4, 0.3], [-0.5, 0.1], [0.1, -0.4]], [[0, 1, 2]]),
    "heptagon": flat(
        [[0.43, 0.26], [0.2, 0.46], [-0.25, 0.43], [-0.5, 0.05], [-0.31, -0.39], [0.1, -0.49], [0.4, -0.3]],
        [[0, i, i + 1] for i in range(1, 6)],
    ),
    "L": flat(
        [[0, 0], [1, 0], [1, 0.3], [0.3, 0.3], [0.3, 1], [0, 1]], [[0, 1, 2], [0, 2, 3], [0, 3, 5], [3, 4, 5]]
    ),
    "frame": flat(
        [
            [-0.5, -0.5],
            [0.5, -0.5],
            [0.5, 0.5],
            [-0.5, 0.5],
            [-0.4, -0.4],
            [0.4, -0.4],
            [0.4, 0.4],
            [-0.4, 0.4],
        ],
        [[0, 1, 5], [0, 5, 4], [1, 2, 6], [1, 6, 5], [2, 3, 7], [2, 7, 6], [3, 0, 4], [3, 4, 7]],
    ),
    "roof of 4 deg": gabled(4.0),
    "roof of 8 deg": gabled(8.0),
    "roof of 16 deg": gabled(16.0),
}


@pytest.mark.parametrize("wavelengths", [1.0, 3.0, 6.0])
@pytest.mark.parametrize("body", BODIES)
def test_pattern_of_flat_facets_with_coarse_rays(body: str, wavelengths: float) -> None:
    """Rays 6 wavelengths apart give the lobes of any outline, and creases of a few degrees are edges."""
    triangles = BODIES[body]
    closed = "roof" in body
    rng = np.random.default_rng(3)
    tilt = (0.3 if closed else 0.08) * np.sqrt(rng.random(150))
    turn = 2.0 * np.pi * rng.random(150)
    look = np.column_stack([np.sin(tilt) * np.cos(turn), np.sin(tilt) * np.sin(turn), np.cos(tilt)])
    points = triangles.reshape(-1, 3)
    want = pattern(triangles - 0.5 * (points.min(axis=0) + points.max(axis=0)), look, closed=closed)
    got = traced(triangles, look, wavelengths * WAVELENGTH)
    strong = np.abs(want) > 0.03 * np.abs(want).max()
    error = 20.0 * np.log10(np.abs(got[strong]) / np.abs(want[strong]))
    # tol: the parts of edges nearly along a row of rays that are farther than the rays' reach
    assert np.sqrt(np.mean(error**2)) < 0.15
    assert abs(10.0 * np.log10(np.sum(np.abs(got) ** 2) / np.sum(np.abs(want) ** 2))) < 0.05
