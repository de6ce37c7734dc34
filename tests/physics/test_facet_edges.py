"""Returns of single edges: what is left of a smooth facet seen off its glint stands at its edges, whatever the rays."""

from pathlib import Path

import numpy as np
import pytest

from sarmitsuba.focusing import focus
from sarmitsuba.loader.load import load_scene
from sarmitsuba.mesh.boundary_edges import boundary_edges
from sarmitsuba.simulation.raw import simulate

LOOK, WIDTH, DEPTH = 40.0, 2.0, 40.0

SCENE = """<scene version="3.0.0">
<integrator type="sar_path"><float name="ray_spacing" value="{spacing}"/></integrator>
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
    for side, triangle in zip(boundary_edges(grid[faces]), grid[faces], strict=True):
        found = distances(side, triangle, point)
        assert found == pytest.approx([0.75, 1.0, 1.25, 3.0], abs=2e-4)  # m; float32 at 1 km is good to 6e-5


def test_the_arm_of_an_l_ends_at_its_own_sides() -> None:
    """A post 0.2 wide and 8 high with an arm to the right at its top."""
    polygon = [[0, 0], [0.2, 0], [0.2, 7.8], [1.5, 7.8], [1.5, 8], [0, 8]]
    corners = outline(polygon, [[0, 1, 2], [0, 2, 5], [5, 2, 4], [2, 3, 4]])
    sides = boundary_edges(corners)
    for post in (0, 1):
        found = distances(sides[post], corners[post], [0.1, 4.0])
        assert found == [0.1, 0.1, 4.0, 4.0]
    arm = distances(sides[3], corners[3], [1.0, 7.9])
    assert arm[:2] == [0.1, 0.1]
    assert 0.5 in arm


def test_a_lone_triangle_has_three_sides() -> None:
    corners = outline([[0, 0], [1, 0], [0, 1]], [[0, 1, 2]])
    found = distances(boundary_edges(corners)[0], corners[0], [0.25, 0.25])
    assert found == pytest.approx([0.25, 0.25, np.sqrt(0.125)], abs=1e-5)
