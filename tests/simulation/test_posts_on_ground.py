"""Posts on smooth ground at automatic settings: rays that meet a curved surface after the ground are dense enough."""

from pathlib import Path

import numpy as np
import pytest

from sarmitsuba.loading.load import load_scene
from sarmitsuba.simulation.execution.render import render
from sarmitsuba.simulation.execution.run import Run
from sarmitsuba.simulation.planning.sampling import chains
from sarmitsuba.simulation.planning.sampling.chains import Draw, exchange_rays, halve_spacing
from sarmitsuba.tracing.kernel.launch import lattice
from sarmitsuba.truth.theory.half_space import fresnel

SCENE = """<scene version="3.0.0">
<integrator type="sar_path"/>
<sensor type="sar_antenna"><string name="mode" value="spotlight"/><float name="slant_range" value="2000"/>
<float name="look_angle_deg" value="55"/><float name="center_frequency" value="5.4e9"/>
<float name="bandwidth" value="2e8"/><float name="azimuth_resolution" value="0.75"/>
<string name="polarisation" value="HH"/><float name="aim_x" value="0"/><float name="aim_y" value="0"/>
<film type="range_film"><float name="image_extent_azimuth" value="12"/><float name="image_extent_range" value="36"/>
</film>
</sensor>
<shape type="rectangle"><transform name="to_world"><scale x="40" y="40" z="1"/></transform>
<bsdf type="radar_material"><string name="material" value="asphalt"/></bsdf></shape>
<shape type="cylinder"><point name="p0" x="0" y="0" z="0"/><point name="p1" x="0" y="0" z="{h}"/>
<float name="radius" value="{a}"/><bsdf type="radar_material"><string name="material" value="metal"/></bsdf></shape>
</scene>"""


def closed_form(a: float, h: float, eps: complex, rms: float) -> float:
    """RCS, m^2, of a metal post on ground: 4 k a h^2 sin(theta) |R|^2, less the range's curvature over its height."""
    k, theta, reach = 2.0 * np.pi * 5.4e9 / 299792458.0, np.radians(55.0), 2000.0
    z = np.linspace(0.0, h, 2001)
    over = np.exp(-1j * k * np.square(z * np.sin(theta)) / reach)
    seen = abs(np.trapezoid(over, z)) * np.exp(-2.0 * (k * rms * np.cos(theta)) ** 2)
    reflection = abs(complex(fresnel(np.cos(theta), eps)[0]))
    return float(4.0 * k * a * np.sin(theta) * (seen * reflection) ** 2)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:.*falls outside the receive window")
@pytest.mark.filterwarnings("ignore:.*leaves out returns")  # the tube is open above: a wave guide
@pytest.mark.parametrize(("a", "h"), [(0.04, 6.0), (0.15, 4.0), (0.15, 8.0), (0.6, 4.0)])
def test_posts_are_as_bright_as_the_closed_form(tmp_path: Path, a: float, h: float) -> None:
    path = tmp_path / "post.xml"
    path.write_text(SCENE.format(a=a, h=h))
    scene = load_scene(path)
    ground = next(m for m in scene.materials if not m.pec and abs(m.permittivity) < 100.0)
    image = render(scene)
    found = float(np.max(image.rcs()))
    # tol: both halves of the double bounce are estimates of their own, which differ by up to 1.3 dB; before: -3 dB
    assert abs(10.0 * np.log10(found / closed_form(a, h, ground.permittivity, ground.rms_height))) < 1.0
    assert image.metadata["witnesses"]["rays"]["error_db"] < -15.0


def test_a_post_narrower_than_a_cell_is_found_behind_the_ground(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Rays 0.6 m apart and a post of 0.06 m: the mirror image of the post has fine rays all along, in every lattice."""
    monkeypatch.setattr(chains, "SEARCHED", 0)  # one ray a cell, as in large scenes
    a, h = 0.03, 5.4
    path = tmp_path / "post.xml"
    path.write_text(SCENE.format(a=a, h=h))
    coarse = {"azimuth_resolution": 5.0, "bandwidth": 27e6, "image_extent_azimuth": 30.0}
    scene = load_scene(path, radar=None).replace(**coarse, endless_ground="off")
    run = Run(scene)
    assert run.sampling is not None
    image = 2.0 * a * h * np.sin(np.radians(55.0))
    for grids in run.lattices(run.sampling, 0):
        (grid,) = [each for each in grids if each.purpose != "diffuse"]
        assert grid.spacing > 5.0 * a
        rays = np.bincount(grid.level, minlength=len(grid.every_level))
        fine = [
            n * one.spacing**2 for n, one in zip(rays, grid.every_level, strict=True) if one.spacing < 0.3 * a
        ]
        later = [one.serves == "later" for one in grid.every_level if one.spacing < 0.3 * a]
        # tol: 5 %, the foot, whose cells the plain rays cut
        assert sum(np.array(fine)[later]) > 0.95 * image


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:.*leaves out returns")  # tubes open above are wave guides
def test_posts_that_mirror_each_other_leave_rays_for_the_ground(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A stand of trunks: tubes that one post spreads over others lack any number of rays; double bounces come first."""
    monkeypatch.setattr(chains, "MOST_RAYS", 100_000)
    post = SCENE[SCENE.index('<shape type="cylinder">') : SCENE.index("</scene>")]
    rng = np.random.default_rng(4)
    posts = ""
    for x, y in rng.uniform(-8.0, 8.0, (14, 2)):
        moved = post.format(a=0.15, h=8.0).replace('x="0" y="0"', f'x="{x:.2f}" y="{y:.2f}"')
        posts += moved
    path = tmp_path / "stand.xml"
    path.write_text(SCENE.format(a=0.15, h=8.0).replace("</scene>", posts + "</scene>"))
    band = {"center_frequency": "1.3e9", "bandwidth": "6e7", "azimuth_resolution": "2.5"}
    band = {f"sar_antenna.{name}": value for name, value in band.items()}
    scene = load_scene(path, radar=None, parameters=band).replace(image_extent_azimuth=40.0)
    scene = scene.replace(endless_ground="off", max_depth=3)
    run = Run(scene)
    assert run.sampling is not None
    for grids in run.lattices(run.sampling, 0):
        (grid,) = [each for each in grids if each.purpose != "diffuse"]
        need = np.maximum(run.trace_scene.needs[0].min(), chains.FINEST * scene.radar.waveform.wavelength)
        ground = [one for one in grid.every_level if one.serves == "later" and not np.isfinite(one.needs[1])]
        # tol: a factor of two, what the small bound on rays allows; by the lack alone the ground got none
        assert min(one.spacing for one in ground) <= 2.0 * need


def test_halved_lattices_tile_the_same_area() -> None:
    grid = lattice(3.0, 2.0, 0.25)
    finer = halve_spacing(grid)
    assert finer.n_rays == 4 * grid.n_rays and [one.spacing for one in finer.every_level] == [0.125]
    parts = [exchange_rays(grid, {0: Draw(5, k, 8, 2, 3.0)}) for k in range(5)]
    # each drawn ray is exchanged for sixteen: their areas cancel
    assert sum(part.n_rays for part in parts) == 17 * grid.n_rays
    for part in parts:
        area = [level.weight * level.spacing**2 for level in part.every_level]
        assert np.dot(np.bincount(part.level), area) == pytest.approx(0.0, abs=1e-9)
        assert part.every_level[0].weight == 3.0
    # tol: float32 coordinates
    np.testing.assert_allclose([finer.x.mean(), finer.y.mean()], [grid.x.mean(), grid.y.mean()], atol=1e-5)


@pytest.mark.parametrize("seed", range(3))
def test_rays_exchanged_all_together_cover_the_window_up_to_its_rim(seed: int) -> None:
    """A lone body fills a window without a taper: cells beside the last ones hold a part of it, and no ray."""
    grid = lattice(0.5, 0.7, 0.03, seed=seed)
    found = exchange_rays(grid, {0: Draw(1, 0, 64, 3, 1.0)})
    fine, coarse = found.every_level
    n_coarse = grid.n_rays
    area = (found.n_rays - n_coarse) * fine.spacing**2
    assert (fine.weight, coarse.weight) == (1.0, -1.0)
    # tol: cells of 3.75 mm cut by a rim of 4.8 m, at random
    assert area == pytest.approx(1.4, rel=1e-3)
    assert (np.abs(found.x) <= 0.5).all()
