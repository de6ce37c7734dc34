"""Circular tracks: every aspect is lit as fully as broadside, up to the whole circle."""

import itertools
from pathlib import Path

import numpy as np
import pytest

import sarmitsuba
from sarmitsuba.radar.image_request import ImageRequest
from sarmitsuba.scene.scene import Scene
from sarmitsuba.signal.raw_data import RawData
from sarmitsuba.simulation.execution.rcs import monostatic_rcs
from sarmitsuba.simulation.execution.run import Run
from sarmitsuba.simulation.planning.sampling.launch_window import sectors
from tests.support.unweighted import focus

REACH = 1000.0
SCENE = """<scene version="3.0.0">
  <integrator type="sar_path"><integer name="max_depth" value="1"/><string name="method" value="{method}"/></integrator>
  <sensor type="sar_antenna" id="radar">
    <string name="track_file" value="track.csv"/><string name="mode" value="spotlight"/>
    <film type="range_film">
      <float name="image_extent_azimuth" value="8"/><float name="image_extent_range" value="8"/>
    </film>
  </sensor>
  <bsdf type="radar_material" id="metal"><string name="material" value="pec"/></bsdf>
  {shapes}
</scene>
"""
SPHERE = (
    '<shape type="sphere" id="ball"><point name="center" x="0.6" y="-0.4" z="1"/><float name="radius" value="0.3"/>'
    '<ref id="metal"/></shape>'
)
BOX = (
    '<shape type="cube" id="box"><transform name="to_world"><scale x="0.5" y="0.2" z="0.3"/><rotate z="1" angle="20"/>'
    '<translate x="0.3"/></transform><ref id="metal"/></shape>'
)
POINT = (
    '<shape type="sphere" id="point"><point name="center" x="0.6" y="-0.4" z="0"/><float name="radius" value="0.1"/>'
    '<bsdf type="point_scatterer"/></shape><shape type="rectangle" id="floor"><ref id="metal"/>'
    '<transform name="to_world"><scale value="1.5"/></transform></shape>'
)

pytestmark = pytest.mark.filterwarnings("ignore:.*Doppler bandwidth")  # few pulses: aspects, not images


def circle(
    folder: Path, degrees: float, pulses: int, shapes: str, method: str = "raw", height: float = 300.0
) -> Scene:
    angle = np.radians(np.linspace(-0.5 * degrees, 0.5 * degrees, pulses))
    place = [-REACH * np.cos(angle), REACH * np.sin(angle), np.full(pulses, height)]
    rows = np.column_stack([np.arange(pulses) / 200.0, *place])
    np.savetxt(folder / "track.csv", rows, delimiter=",", header="time_s, x_m, y_m, z_m", fmt="%.9f")
    (folder / "scene.xml").write_text(SCENE.format(shapes=shapes, method=method))
    return sarmitsuba.load_scene(folder / "scene.xml")


def amplitudes(raw: RawData) -> np.ndarray:
    """sqrt(RCS) of every pulse at the centre frequency, m: the echo's spectrum at zero."""
    radar = raw.radar
    distance = np.linalg.norm(radar.track.position - radar.aim_point, axis=1)
    echo = raw.total(raw.channels[0]).sum(axis=1) * radar.window.sample_spacing / radar.waveform.range_cell
    return np.abs(echo) * distance**2 / radar.amplitude_constant


@pytest.mark.slow
@pytest.mark.parametrize("degrees", [200.0, 300.0, 360.0])
def test_sphere_is_the_same_from_every_aspect(tmp_path: Path, degrees: float) -> None:
    raw = sarmitsuba.simulate(circle(tmp_path, degrees, 25, SPHERE))
    error = 20.0 * np.log10(amplitudes(raw) / (0.3 * np.sqrt(np.pi)))
    # tol: sphere ka = 60 with 4.5 rays per wavelength 0.2 dB; one launch plane for all was 1.1 to 2.6 dB out
    assert np.abs(error).max() < 0.3


@pytest.mark.filterwarnings("ignore:.*edge_diffraction is switched off")
def test_box_is_that_of_a_launch_plane_of_its_own_at_every_aspect(tmp_path: Path) -> None:
    scene = circle(tmp_path, 360.0, 73, BOX).replace(edge_diffraction="off")  # as below
    got = amplitudes(sarmitsuba.simulate(scene))
    track, middle = scene.radar.track, scene.geometry.bounds.mean(axis=0)
    towards = track.position - middle
    expected = np.abs(
        monostatic_rcs(
            scene.geometry,
            scene.materials,
            towards,
            scene.radar.waveform.center_frequency,
            channels=scene.radar.channels,
            max_depth=1,
            distance=float(np.linalg.norm(towards, axis=1).mean()),
        ).amplitude[:, 0, 0]
    )
    # tol: two lattices of 4.5 rays per wavelength, -30 dB of the flashes each; a range that differs by 0.3 m of 1044 m
    assert np.abs(got - expected).max() < 0.02 * expected.max()
    assert np.sqrt(np.mean((got - expected) ** 2)) < 0.05 * np.sqrt(np.mean(expected**2))


def test_sectors_cover_the_track_and_a_usual_aperture_is_one(tmp_path: Path) -> None:
    scene = circle(tmp_path, 360.0, 361, BOX)
    found = sectors(scene)
    assert found[0][0] == 0 and found[-1][1] == 361
    assert all(a[1] == b[0] for a, b in itertools.pairwise(found))
    line = -scene.radar.track.position / np.linalg.norm(scene.radar.track.position, axis=1, keepdims=True)
    for first, end in found:
        assert np.degrees(np.arccos(np.clip(line[first:end] @ line[first:end].T, -1, 1))).max() < 21.0
    assert len(sectors(circle(tmp_path, 15.0, 64, BOX))) == 1
    run = Run(scene)
    lattices = run.lattices(run.sampling, 0)[0]
    for pulse in range(0, 361, 30):
        served = [grid for grid in lattices if grid.serves(pulse)]
        assert served and all(grid.frame is not None for grid in served)


@pytest.mark.slow
def test_whole_circle_comes_out_as_a_point_in_its_place(tmp_path: Path) -> None:
    # aspects a wavelength apart at the edge of what is focused: 2 pi 0.25 m / (0.031 m / 4) = 202 and some spare
    scene = circle(tmp_path, 360.0, 300, POINT, "hybrid")
    request = ImageRequest("ground", 0.6, -0.4, 0.0, 0.25, 0.25, 0.004, 0.004)
    image = focus(sarmitsuba.simulate(scene), request=request, focuser="backprojection")
    power = np.abs(image.total())
    row, column = np.unravel_index(power.argmax(), power.shape)
    place = image.grid.positions_on_line(int(row))[int(column)]
    assert np.linalg.norm(place[:2] - [0.6, -0.4]) < 0.004
    # tol: the floor's rim below the point, and side lobes of it: -30 dB
    assert abs(20.0 * np.log10(power.max())) < 0.5
