"""The examples of docs/extending.md run as they stand, and what they add works."""

import gc
import re
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from scipy.special import j1

from sarmitsuba.core.errors import DataError, RadarError, SarmitsubaWarning, SceneError
from sarmitsuba.core.registry import Registry
from sarmitsuba.core.units import db_from_power
from sarmitsuba.effects.effect import EFFECTS
from sarmitsuba.effects.plan import plan_effects
from sarmitsuba.files import write_image
from sarmitsuba.loading.load import load_scene
from sarmitsuba.loading.tables import INTEGRATOR, RADAR_MATERIAL, SENSOR
from sarmitsuba.machine.backend import arrays, device_numbers, dr
from sarmitsuba.radar.image_request import ImageRequest
from sarmitsuba.scene.materials.diffuse import diffuse_tables
from sarmitsuba.signal.focusing.ideal import ideal_echoes, ideal_radar
from sarmitsuba.signal.focusing.windows import parse_window
from sarmitsuba.simulation.execution.path_table import trace_paths
from sarmitsuba.simulation.execution.render import simulate
from sarmitsuba.simulation.execution.turntable import Aspects, rcs_sweep
from sarmitsuba.tracing.kernel.stage import STAGES
from tests.support.unweighted import focus, render

PAGE = Path(__file__).parents[2] / "docs" / "extending.md"


@dataclass(frozen=True)
class Example:
    """One section of the page.

    Parameters
    ----------
    heading : of the section
    python : its Python blocks, joined
    xml : its XML blocks
    """

    heading: str
    python: str
    xml: tuple[str, ...]


def examples() -> dict[str, Example]:
    """Sections that hold Python, by heading."""
    found = {}
    for section in PAGE.read_text(encoding="utf-8").split("\n## ")[1:]:
        heading, _, text = section.partition("\n")
        blocks = re.findall(r"```python\n(.*?)```", text, re.DOTALL)
        if (
            blocks and heading != "A benchmark"
        ):  # test_benchmarks.py runs that one, in the benchmarks' own folder
            xml = tuple(re.findall(r"```xml\n(.*?)```", text, re.DOTALL))
            found[heading] = Example(heading, "\n".join(blocks), xml)
    return found


EXAMPLES = examples()


@pytest.fixture(autouse=True)
def registries_as_they_were() -> Iterator[None]:
    """Take what an example has registered out again; every registry there is, whoever made it."""
    found = [thing for thing in gc.get_objects() if isinstance(thing, Registry)]
    for registry in found:
        registry.names  # noqa: B018  loads the built-in entries, which are to stay
    before = [(registry, dict(registry._entries), dict(registry._owners)) for registry in found]
    yield
    for registry, entries, owners in before:
        registry._entries, registry._owners = entries, owners


@pytest.fixture
def module() -> Iterator[ModuleType]:
    """A module of its own for an example to run in."""
    made = ModuleType("sarmitsuba_example")
    sys.modules[made.__name__] = made
    yield made
    del sys.modules[made.__name__]


SCENE = """<scene version="3.0.0">
    {integrator}
    <sensor type="sar_antenna">
        <string name="polarisation" value="HH,VV"/>
        <float name="look_angle_deg" value="40"/>
        <float name="bandwidth" value="150e6"/>
        <film type="range_film"/>
    </sensor>
    {bsdf}
    <shape type="rectangle">
        <transform name="to_world"><scale x="8" y="8"/></transform>
        <ref id="{id}"/>
    </shape>
    {shape}
</scene>
"""
METAL = '<bsdf type="radar_material" id="metal"><string name="material" value="pec"/></bsdf>'
AUTO = '<integrator type="sar_path"/>'
POINT = """<shape type="sphere">
    <point name="center" x="0" y="0" z="2"/>
    <bsdf type="point_scatterer"><float name="rcs_dbsm" value="40"/></bsdf>
</shape>"""


def write(
    folder: Path, bsdf: str = METAL, identifier: str = "metal", integrator: str = AUTO, shape: str = ""
) -> Path:
    path = folder / "scene.xml"
    text = SCENE.format(bsdf=bsdf, id=identifier, integrator=integrator, shape=shape)
    path.write_text(text, encoding="utf-8")
    return path


def check_a_diffuse_law(example: Example, folder: Path) -> None:
    """From the scene file to the echoes: level, polarisation, a documented and bounded parameter of its own."""
    scene = load_scene(write(folder, example.xml[0], "meadow"))
    material = scene.materials[0]
    assert material.diffuse_law == "mylaw" and material.law_parameter("fall_db_per_deg") == 0.25
    wavelength = scene.radar.waveform.wavelength
    h, v = diffuse_tables(material, wavelength).sigma0(np.radians(40.0))
    # tol: linear interpolation between 256 nodes
    assert db_from_power(h) == pytest.approx(-5.0 - 10.0 + 10.0 * np.log10(np.cos(np.radians(40))), abs=1e-3)
    assert db_from_power(v / h) == pytest.approx(2.0, abs=1e-9)
    raw = simulate(scene)
    power = [float((np.abs(raw.total(channel)) ** 2).sum()) for channel in ("HH", "VV")]
    # tol: both channels carry the same speckle; 16 m of ground at 10 km
    assert db_from_power(power[1] / power[0]) == pytest.approx(2.0, abs=0.05)
    assert "fall_db_per_deg" in RADAR_MATERIAL.markdown() and "mylaw" in RADAR_MATERIAL.markdown()
    with pytest.raises(SceneError, match="fall_db_per_deg = -1 dB is below the bound 0 dB"):
        load_scene(write(folder, example.xml[0].replace("0.25", "-1"), "meadow"))
    with pytest.raises(
        SceneError, match="fall_db_per_deg has no effect with diffuse_law = lambert; take mylaw"
    ):
        load_scene(write(folder, example.xml[0].replace("mylaw", "lambert"), "meadow"))


def check_a_material(example: Example, folder: Path) -> None:
    """Its permittivity is the scene's, at the scene's frequency."""
    scene = load_scene(write(folder, example.xml[0], "sea"))
    eps = scene.materials[0].permittivity
    assert eps.real == pytest.approx(58.0, abs=1.0) and eps.imag == pytest.approx(-34.5, abs=1.0)
    tile = example.xml[0].replace("brackish_water", "roof_tile")
    assert load_scene(write(folder, tile, "sea")).materials[0].permittivity == 4.0 - 0.1j
    with pytest.raises(SceneError, match=r'"brackish_watr" is not one of .*; did you mean "brackish_water"'):
        load_scene(write(folder, example.xml[0].replace("brackish_water", "brackish_watr"), "sea"))


def check_an_effect(example: Example, folder: Path) -> None:
    """A line in the plan, a switch in the scene file and the table, and points that leave the echoes."""
    assert "point_targets" in INTEGRATOR.markdown()
    on = load_scene(write(folder, shape=POINT))
    off = load_scene(write(folder, integrator=example.xml[0], shape=POINT))
    bare = load_scene(write(folder))
    assert [plan_effects(s, warn=False).on("point_targets") for s in (on, off, bare)] == [True, False, False]
    seen = simulate(on)
    with pytest.warns(SarmitsubaWarning, match="point_targets is switched off; predicted error at most 0 dB"):
        hidden = simulate(off)
    assert hidden.metadata["effects"]["effects"]["point_targets"]["on"] is False
    # the plate alone is far below the point
    assert np.abs(seen.total("VV")).max() > 10.0 * np.abs(hidden.total("VV")).max()


def check_an_effect_of_the_trace_kernel(example: Example, folder: Path) -> None:
    """Every echo is weaker by the closed form, of surfaces and points, in every method; off it keeps the bits."""
    wet = load_scene(write(folder, shape=POINT))
    dry = wet.replace(rain="off")
    distance = float(np.linalg.norm(wet.radar.track.center_position))
    loss = 10.0 ** (-2e-3 * 0.4 * distance / 20.0)
    off = pytest.warns(SarmitsubaWarning, match="rain is switched off")
    for method in ("hybrid", "raw", "image"):
        one = render(wet.replace(method=method)).total("VV")
        with off:
            other = render(dry.replace(method=method)).total("VV")
        # tol: 16 m of ground at 10 km
        assert np.linalg.norm(one - loss * other) < 2e-3 * np.linalg.norm(loss * other), method
    with off:
        paths, all_paths = trace_paths(wet), trace_paths(dry)
        aspects = Aspects(np.zeros(1), np.full(1, np.radians(50.0)))
        assert rcs_sweep(wet, aspects).dbsm("VV") == rcs_sweep(dry, aspects).dbsm("VV")
        bits = simulate(dry).data
    # surfaces, their edges, and the point
    assert len(set(paths.kind)) == 3 and len(paths.length) == len(all_paths.length)
    # tol: as above
    assert paths.power.sum() == pytest.approx(all_paths.power.sum() * loss**2, rel=4e-3)
    with pytest.raises(RadarError, match="method raster traces no paths, so that rain has no effect"):
        render(wet.replace(method="raster"))
    del EFFECTS._entries["rain"], STAGES._entries["rain"]
    np.testing.assert_array_equal(bits, simulate(load_scene(folder / "scene.xml")).data)


def check_a_scatterer(example: Example, folder: Path) -> None:
    """The level of the closed form, as an ideal point's; nothing beyond the cone; over the ground; refusals."""
    wavelength = load_scene(write(folder)).radar.waveform.wavelength
    dbsm = 10.0 * np.log10(4.0 * np.pi**3 * 0.3**4 / wavelength**2)
    point = POINT.replace('value="40"', f'value="{dbsm:.9f}"')
    lens, ideal = (load_scene(write(folder, shape=shape)) for shape in (example.xml[0], point))
    assert lens.scatterers[0].values == {"radius": 0.3, "cone_deg": 60.0}
    assert lens.replace(look_angle_deg=41.0).scatterers[0].kind == "luneburg_lens"
    for method in ("hybrid", "image"):
        images = [
            render(scene.replace(method=method, max_depth=1, visibility="on")) for scene in (lens, ideal)
        ]
        for channel in ("HH", "VV"):
            one, other = (image.total(channel) for image in images)
            # tol: the grid's kernel, and the interpolation between two frequencies; ideal points are exact
            assert np.linalg.norm(one - other) < 6e-3 * np.linalg.norm(other), (method, channel)
    level = load_scene(write(folder, shape=example.xml[0].replace('angle="-40"', 'angle="-90"')))
    assert {1, 2, 3} <= set(trace_paths(level.replace(max_depth=3)).order)  # its ground below as a mirror
    sight = lens.radar.track.center_position
    aspects = Aspects(np.array([np.arctan2(sight[1], sight[0])]), np.full(1, np.radians(50.0)))
    bare = load_scene(write(folder))
    alone = rcs_sweep(lens.replace(max_depth=1), aspects).result.amplitude.sum(axis=1)[0, 1]
    plate = rcs_sweep(bare.replace(max_depth=1), aspects).result.amplitude.sum(axis=1)[0, 1]
    assert 20.0 * np.log10(np.abs(alone - plate)) == pytest.approx(dbsm, abs=0.01)  # tol: float32
    away = load_scene(write(folder, shape=example.xml[0].replace('angle="-40"', 'angle="40"')))
    with pytest.warns(SarmitsubaWarning, match=r"own_scatterers is switched off.*1 luneburg_lens"):
        off = simulate(away.replace(max_depth=1, own_scatterers="off")).data
    dark, lit = (simulate(scene.replace(max_depth=1)).data for scene in (away, lens))
    # tol: the launch window's middle is another, and with it the plate's rays
    assert np.abs(dark - off).max() < 1e-3 * np.abs(lit).max()
    with pytest.raises(SceneError, match="luneburg_lens is on a cube; put it on a sphere"):
        load_scene(write(folder, shape=example.xml[0].replace("sphere", "cube")))
    with pytest.raises(SceneError, match=r"radius = -1 m is below the bound 0\.01 m"):
        load_scene(write(folder, shape=example.xml[0].replace("0.3", "-1")))
    assert "own_scatterers" in INTEGRATOR.markdown()


def check_a_radar_mode(example: Example, folder: Path) -> None:
    """Its beam is the scene's, whose footprint moves as fast as the file says; its parameter is its own."""
    sensor = '<sensor type="sar_antenna">'
    path = write(folder)
    path.write_text(path.read_text().replace(sensor, example.xml[0].replace("</sensor>", "")))
    radar = load_scene(path).radar
    footprint = radar.track.position + 10e3 * radar.pointing.boresight
    moved, flown = ((line[-1] - line[0]) @ radar.track.along for line in (footprint, radar.track.position))
    # tol: the aim point's range changes over the aperture
    assert moved / flown == pytest.approx(2.0, abs=1e-3)
    assert "footprint_speed_ratio" in SENSOR.markdown()
    path.write_text(path.read_text().replace("sweeping", "stripmap"))
    with pytest.raises(RadarError, match="footprint_speed_ratio"):
        load_scene(path)


def check_an_antenna_pattern(example: Example, folder: Path) -> None:
    """Its gain is the disc's, in NumPy and in the kernels, and the scene's point is as much weaker."""
    sensor = '<sensor type="sar_antenna">'
    path = write(folder, shape=POINT)
    path.write_text(path.read_text().replace(sensor, example.xml[0].replace("</sensor>", "")))
    antenna = load_scene(path).radar.antenna
    sine = np.linspace(-0.04, 0.04, 81)
    x = 1.61634 * sine / np.sin(np.radians(1.0))
    want = np.where(np.abs(x) < 3.8317, (2.0 * j1(x) / np.where(x == 0.0, 1.0, x)) ** 2, 0.0)
    want[x == 0.0] = 1.0
    got = antenna.two_way_amplitude(sine, np.zeros_like(sine))
    np.testing.assert_allclose(got, want, atol=2e-4)  # tol: the series as the page has it
    types = arrays()
    numbers = device_numbers(types.Float32, antenna.numbers)
    lanes = types.Float32(sine.astype(np.float32))
    kernel = antenna.normalise(lanes, types.Float32(0.0), numbers, dr)
    np.testing.assert_allclose(np.asarray(kernel), got, atol=2e-6)  # tol: float32
    assert np.abs(simulate(load_scene(path)).total("HH")).max() > 0.0


def check_a_focuser(example: Example, folder: Path) -> None:
    """The built-in backprojection's image and levels; its option bounds what it takes."""
    raw = ideal_echoes(
        ideal_radar(slant_range=10e3, resolution=2.0, n_samples=128), np.array([1.3, -2.1, 0.0]), rcs=2.5
    )
    request = ImageRequest(extent_azimuth=20.0, extent_range=20.0)
    image, exact = (
        focus(raw, request=request, focuser=name, range_window="taylor")
        for name in ("numpy_backprojection", "backprojection")
    )
    # tol: linear interpolation
    assert np.linalg.norm(image.data - exact.data) < 0.01 * np.linalg.norm(exact.data)
    np.testing.assert_allclose(image.sigma0(), exact.sigma0(), rtol=0.05, atol=1e-3 * exact.sigma0().max())
    with pytest.raises(DataError, match=r"largest = 1e\+03; take focuser backprojection or .*omega_k"):
        focus(raw, request=request, focuser="numpy_backprojection,largest=1000")


def check_a_window(example: Example, folder: Path) -> None:
    """Its limits are a Hann and no window; it broadens with its parameter."""
    u = np.linspace(-0.5, 0.5, 101)
    assert str(parse_window("tukey")) == "tukey:0.5"
    np.testing.assert_allclose(parse_window("tukey:1")(u), parse_window("hann")(u), atol=1e-12)
    np.testing.assert_allclose(parse_window("tukey:0")(u[1:-1]), 1.0)
    assert 1.0 < parse_window("tukey:0.25").broadening < parse_window("tukey:0.75").broadening


def check_a_file_format(example: Example, folder: Path) -> None:
    """Found by its suffix, and holds what was written."""
    raw = ideal_echoes(ideal_radar(n_samples=64, resolution=4.0), np.zeros(3))
    image = focus(raw, request=ImageRequest(extent_azimuth=16.0, extent_range=16.0))
    write_image(image, folder / "image.npz")
    with np.load(folder / "image.npz") as saved:
        np.testing.assert_array_equal(saved[image.channels[0]], image.total())
        np.testing.assert_array_equal(saved["range"], image.grid.range)


CHECKS: dict[str, Callable[[Example, Path], None]] = {
    "A diffuse law": check_a_diffuse_law,
    "A material": check_a_material,
    "An effect": check_an_effect,
    "An effect of the trace kernel": check_an_effect_of_the_trace_kernel,
    "A scatterer": check_a_scatterer,
    "A radar mode": check_a_radar_mode,
    "An antenna pattern": check_an_antenna_pattern,
    "A focuser": check_a_focuser,
    "A window": check_a_window,
    "A file format": check_a_file_format,
}


# each method with it and without it, and as many kernels to compile; test_extension_faults.py and test_own_lobes.py
# hold what stages and scatterers may do
SLOW = {"An effect of the trace kernel", "A scatterer"}


@pytest.mark.parametrize(
    "heading", [pytest.param(h, marks=pytest.mark.slow if h in SLOW else ()) for h in EXAMPLES]
)
def test_an_example_of_the_page_runs_and_works(heading: str, module: ModuleType, tmp_path: Path) -> None:
    assert heading in CHECKS, "a section with code has no check"
    example = EXAMPLES[heading]
    exec(compile(example.python, f"{PAGE.name}: {heading}", "exec"), vars(module))
    CHECKS[heading](example, tmp_path)


def test_every_check_has_its_section() -> None:
    assert set(CHECKS) <= set(EXAMPLES)
