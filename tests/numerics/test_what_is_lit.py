"""Rays go where the target is: targets smaller than the rays' distance, and walls beyond a cropped image."""

from pathlib import Path

import numpy as np
import pytest

import sarmitsuba
from sarmitsuba.scene.scene import Scene
from sarmitsuba.simulation.execution.run import Run
from tests.support.unweighted import render

SCENE = """<scene version="3.0.0">
  <integrator type="sar_path">
    <integer name="max_depth" value="{depth}"/><float name="ray_spacing" value="{spacing}"/>
    <string name="method" value="{method}"/>
  </integrator>
  <sensor type="sar_antenna" id="radar">
    <float name="slant_range" value="1500"/><float name="azimuth_resolution" value="0.5"/>
    <string name="mode" value="spotlight"/><float name="aim_x" value="0"/><float name="aim_y" value="0"/>
    <film type="range_film">
      <float name="image_extent_azimuth" value="{extent}"/><float name="image_extent_range" value="{extent}"/>
    </film>
  </sensor>
  <bsdf type="radar_material" id="metal"><string name="material" value="pec"/></bsdf>
  {shapes}
</scene>
"""


def scene_of(
    folder: Path, shapes: str, spacing: float, method: str = "raw", depth: int = 1, extent: float = 10.0
) -> Scene:
    path = folder / "scene.xml"
    path.write_text(SCENE.format(shapes=shapes, spacing=spacing, method=method, depth=depth, extent=extent))
    return sarmitsuba.load_scene(path)


def ball(radius: float, x: float = 0.0) -> str:
    return (
        f'<shape type="sphere" id="ball"><point name="center" x="{x}" y="0.3" z="0.2"/>'
        f'<float name="radius" value="{radius}"/><ref id="metal"/></shape>'
    )


@pytest.mark.filterwarnings("ignore:.*coarser than")
@pytest.mark.parametrize("method", ["raw", "hybrid", "image"])
@pytest.mark.parametrize("radius", [0.05, pytest.param(0.2, marks=pytest.mark.slow)])
def test_targets_between_the_rays_are_found(tmp_path: Path, method: str, radius: float) -> None:
    # rays 5 m apart: the plain lattice has none over a ball of centimetres, and may be empty altogether
    for seed in range(3):
        scene = scene_of(tmp_path, ball(radius), 5.0, method)
        image = render(scene, seed=seed) if method == "image" else None
        if image is None:
            raw = sarmitsuba.simulate(scene, seed=seed)
            distance = np.linalg.norm(raw.radar.track.position - [0.0, 0.3, 0.2], axis=1)
            echo = (
                raw.total(raw.channels[0]).sum(axis=1)
                * raw.radar.window.sample_spacing
                / raw.radar.waveform.range_cell
            )
            level = np.abs(echo) * distance**2 / raw.radar.amplitude_constant
        else:
            level = np.abs(image.total(image.channels[0])).max()
        # tol: physical optics of ka = 10 ripples by 1 / ka; an image's pixels lie up to 1.4 dB off the peak
        assert np.abs(20.0 * np.log10(level / (np.sqrt(np.pi) * radius))).max() < 2.0


def test_no_scene_reaches_the_kernel_without_rays(tmp_path: Path) -> None:
    # a single facet seen edge-on, and balls far smaller than the wavelength
    edge_on = (
        '<shape type="rectangle" id="sheet"><transform name="to_world"><scale value="0.01"/></transform>'
        '<ref id="metal"/></shape>'
    )
    for shapes in (edge_on, ball(1e-3), ball(1e-4) + ball(2e-4, 2.0).replace('"ball"', '"other"')):
        scene = scene_of(tmp_path, shapes, 3.0)
        run = Run(scene)
        for grids in run.lattices(run.sampling, 0):
            assert grids and all(grid.n_rays > 0 for grid in grids)


def test_walls_beyond_a_cropped_image_are_said(tmp_path: Path) -> None:
    ground = (
        '<shape type="rectangle" id="ground"><ref id="metal"/>'
        '<transform name="to_world"><scale value="120"/></transform></shape>'
    )
    house = (
        '<shape type="cube" id="house"><ref id="metal"/><transform name="to_world"><scale x="2" y="2" z="15"/>'
        '<translate x="{x}" y="0" z="15"/></transform></shape>'
    )

    def notes(x: float, depth: int = 3) -> list[str]:
        run = Run(scene_of(tmp_path, ground + house.format(x=x), 0.2, depth=depth, extent=20.0))
        return [note for note in run.notes if "could mirror rays" in note]

    assert not notes(0.0)  # within the image
    said = {x: notes(x) for x in (-110.0, -35.0, 35.0, 110.0)}
    # on one side the house lays over into the image and is lit, on the other it stands before it
    assert sorted(len(said[x]) for x in (-35.0, 35.0)) == [0, 1]
    assert not said[-110.0] and not said[110.0]  # farther than its height throws rays
    assert not notes(-35.0, depth=1) and not notes(35.0, depth=1)  # one bounce mirrors nothing
