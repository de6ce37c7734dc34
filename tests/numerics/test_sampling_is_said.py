"""Sampling that cannot work is said, with the number that would do."""

import re
import warnings
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import sarmitsuba
from sarmitsuba.core.errors import RadarError, SarmitsubaWarning
from sarmitsuba.signal.metrics import point_target_in
from sarmitsuba.simulation.execution.raw import _check_energy
from sarmitsuba.simulation.execution.statistics import TraceStatistics
from sarmitsuba.simulation.planning.sampling import small_parts
from tests.support.unweighted import focus

SCENE = """<scene version="3.0.0">
  <integrator type="sar_path"/>
  <sensor type="sar_antenna" id="radar">
    <float name="slant_range" value="5000"/><float name="azimuth_resolution" value="1"/>
    <string name="mode" value="spotlight"/>
    <film type="range_film">
      <float name="image_extent_azimuth" value="20"/><float name="image_extent_range" value="20"/>
    </film>
  </sensor>
  <bsdf type="radar_material" id="metal"><string name="material" value="pec"/></bsdf>
  <shape type="{shape}" id="thing"><ref id="metal"/>
    <transform name="to_world"><scale value="{size}"/></transform></shape>
</scene>
"""


@pytest.fixture
def scene_file(tmp_path: Path):
    def write(shape: str = "cube", size: float = 8.0) -> Path:
        path = tmp_path / "scene.xml"
        path.write_text(SCENE.format(shape=shape, size=size))
        return path

    return write


def said(action) -> list[str]:
    """Texts of the warnings of a call."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        action()
    texts = [str(w.message) for w in caught if issubclass(w.category, SarmitsubaWarning)]
    assert all("\n" not in t for t in texts)
    return texts


def test_good_sampling_says_nothing(scene_file) -> None:
    scene = sarmitsuba.load_scene(scene_file())
    assert said(lambda: sarmitsuba.simulate(scene)) == []


@pytest.mark.parametrize(
    ("parameters", "pattern", "remedy"),
    [
        ({"radar.prf": "20"}, r"prf = 20 Hz is below the Doppler bandwidth (\S+) Hz", "raise prf"),
        (
            {"range_film.near_range": "5000"},
            r"near_range = 5000 m to far_range = 0 m \(0 = automatic\) cuts the image, whose slant ranges are (\S+) m",
            "widen it",
        ),
        (
            {"range_film.far_range": "5000"},
            r"near_range = 0 m to far_range = 5000 m \(0 = automatic\) cuts the image",
            "widen it",
        ),
        (
            {"radar.prf": "2e6", "radar.azimuth_resolution": "100"},
            r"the echoes of one pulse last \S+ m in range, longer than the unambiguous range (\S+) m",
            "lower prf",
        ),
        (
            {"radar.pulse_width": "1e-2", "radar.prf": "200"},
            r"the echoes of one pulse last \S+ m in range, longer than the unambiguous range",
            "pulse_width",
        ),
    ],
    ids=["prf", "near", "far", "range wrap by prf", "range wrap by pulse"],
)
def test_radar_sampling(scene_file, parameters: dict[str, str], pattern: str, remedy: str) -> None:
    """PRF below the Doppler spread, windows that cut the swath, pulses that overlap: one line each, on loading."""
    texts = said(lambda: sarmitsuba.load_scene(scene_file(), parameters=parameters))
    assert len([t for t in texts if re.search(pattern, t) and remedy in t]) == 1


def test_window_beside_the_scene_is_refused(scene_file) -> None:
    for parameters in ({"range_film.near_range": "6000"}, {"range_film.far_range": "4000"}):
        with pytest.raises(RadarError, match="does not hold the scene, whose slant ranges are"):
            sarmitsuba.load_scene(scene_file(), parameters=parameters)
    with pytest.raises(RadarError, match=r"sampling_rate = 1e\+08 Hz is below the bandwidth 3e\+08 Hz"):
        sarmitsuba.load_scene(scene_file(), parameters={"range_film.sampling_rate": "1e8"})


def test_the_prf_that_is_named_would_do(scene_file, row) -> None:
    """At the PRF that the warning asks for, there is no warning; at a tenth less there is.

    Naive way: no check; the image of the point at the edge then shows an alias in its own place.
    """
    texts = said(lambda: sarmitsuba.load_scene(scene_file(), parameters={"radar.prf": "20"}))
    needed = float(re.search(r"Doppler bandwidth (\S+) Hz", texts[0])[1])
    ok = said(lambda: sarmitsuba.load_scene(scene_file(), parameters={"radar.prf": f"{needed * 1.001}"}))
    low = said(lambda: sarmitsuba.load_scene(scene_file(), parameters={"radar.prf": f"{needed * 0.9}"}))
    row("warnings at the PRF that a warning names", float(len(ok)), 0.0, "", naive=float(len(low)))


@pytest.mark.parametrize("method", ["raw", "hybrid"])
def test_contributions_outside_the_window_are_said(scene_file, row, method: str) -> None:
    """A window that ends inside the cube: the run says what share of the echoes' power it could not record.

    Naive way: only paths that leave the accumulator's own grid are counted, which reaches as far as the scene does.
    NumPy stands for it: the share of the same faces outside the ranges of the cube's corners.
    """
    parameters = {
        "range_film.far_range": "4996",
        "radar.aim_z": "0",
        "sar_path.ray_spacing": "0.2",
        "sar_path.method": method,
        "sar_path.coherent": "off",
        "metal.diffuse_law": "lambert",
    }
    path = scene_file()
    path.write_text(path.read_text().replace('"pec"', '"concrete"'))
    cut = []
    said(lambda: cut.append(sarmitsuba.load_scene(path, parameters=parameters)))
    raw = []
    texts = said(lambda: raw.append(sarmitsuba.simulate(cut[0])))
    shares = [
        re.search(r"(\S+) % of the echoes' power falls outside the receive window .* widen near_range", t)
        for t in texts
    ]
    found = [float(m[1]) for m in shares if m]
    # the share of the lit faces beyond the window's end, by the scene's geometry
    antenna, window = cut[0].radar.track.center_position, cut[0].radar.window
    end = window.start_range[0] + window.extent
    x = np.linspace(-8.0, 8.0, 400)
    top = np.stack([*np.meshgrid(x, x), np.full((400, 400), 8.0)], axis=-1)
    side = np.stack([np.full((400, 400), -8.0), *np.meshgrid(x, x)], axis=-1)
    beyond = [np.mean(np.linalg.norm(face - antenna, axis=-1) > end) for face in (top, side)]
    expected = 100.0 * np.mean(beyond)  # both faces are seen under 45 degrees
    corners = np.stack(np.meshgrid(*[[-8.0, 8.0]] * 3), axis=-1).reshape(-1, 3)
    grid_end = np.linalg.norm(corners - antenna, axis=-1).max()
    naive = 100.0 * np.mean([np.mean(np.linalg.norm(f - antenna, axis=-1) > grid_end) for f in (top, side)])
    row(
        f"share of the power that the receive window cuts, method {method}",
        abs(found[0] - expected),
        1.0,
        "%",
        naive=abs(naive - expected),
        remedy="every path is compared with the window itself",
    )


def test_rays_too_sparse_for_the_cell(scene_file) -> None:
    coarse = sarmitsuba.load_scene(scene_file(), parameters={"sar_path.ray_spacing": "0.4"})
    texts = said(lambda: sarmitsuba.simulate(coarse))
    assert any(
        re.search(r"ray_spacing = 0.4 m is coarser than half a resolution cell; set it to (\S+) m or less", t)
        for t in texts
    )


@pytest.mark.slow
def test_rays_too_sparse_for_a_curved_surface(scene_file, row, monkeypatch: pytest.MonkeyPatch) -> None:
    """A sphere whose rays are asked for 0.2 m apart gets the rays it needs; where they are too many, that is said.

    Naive way: the rays asked for and no others.
    """

    def level() -> tuple[float, list[str]]:
        given = {"sar_path.ray_spacing": "0.2", "sar_path.max_depth": "1"}
        scene = sarmitsuba.load_scene(scene_file("sphere", 1.0), parameters=given)
        got = []
        texts = said(lambda: got.append(focus(sarmitsuba.simulate(scene), request=scene.image)))
        return 10 * np.log10(point_target_in(got[0]).rcs), texts

    served, quiet = level()
    assert quiet == []
    monkeypatch.setattr(small_parts, "MOST_RAYS", 0)
    monkeypatch.setattr(small_parts, "SHARE", 0.0)
    sparse, texts = level()
    (text,) = (t for t in texts if "measured here" not in t and "measured against" not in t)
    stated = re.search(
        r"(\d+) % of the surface is too small or too curved for the rays that fit the bound on rays, "
        r"[0-9.]+ m apart: its coherent return is up to (\d+) dB too strong; set ray_spacing to (\S+) m",
        text,
    )
    assert stated is not None and stated[1] == "100"
    exact = 10 * np.log10(np.pi)
    print(served - exact, sparse - exact, text)
    assert float(stated[3]) < 0.07  # sqrt(0.1 lambda rho) is 0.056 m
    # tol: 0.3 dB for the chain and the jitter of 4 rays per first Fresnel zone
    row(
        "sphere of 1 m at rays 0.2 m apart",
        abs(served - exact),
        0.3,
        "dB",
        naive=abs(sparse - exact),
        remedy="a finer lattice over the curved part",
    )


def test_few_strong_echoes_outside_the_window_count_more_than_many_weak_ones() -> None:
    """Energy, not number, says what is lost: half of the contributions at -30 dB is nothing to warn of."""
    weak = TraceStatistics(hits=10, contributions=10, outside=5, power=1.0, power_outside=1e-3)
    strong = TraceStatistics(hits=10, contributions=1000, outside=1, power=1.0, power_outside=0.5)
    scene = SimpleNamespace(name="scene", geometry=SimpleNamespace(n_faces=1), points=())
    assert said(lambda: _check_energy(scene, weak, np.ones(1))) == []
    assert "50.0 %" in said(lambda: _check_energy(scene, strong, np.ones(1)))[0]


def test_wide_rays_over_bodies_that_shade_each_other_are_said(scene_file) -> None:
    path = scene_file(size=1.0)
    second = (
        '<shape type="cube" id="other"><ref id="metal"/>'
        '<transform name="to_world"><translate x="3"/></transform></shape>'
    )
    path.write_text(path.read_text().replace("</scene>", second + "</scene>"))
    wide = {"sar_path.ray_spacing": "0.15"}  # 4.8 wavelengths
    (text,) = said(lambda: sarmitsuba.simulate(sarmitsuba.load_scene(path, parameters=wide)))
    assert "shadow or mirror each other" in text
    assert said(lambda: sarmitsuba.simulate(sarmitsuba.load_scene(path))) == []
    # one convex body: its tubes end at its own edges
    alone = sarmitsuba.load_scene(scene_file(), parameters=wide)
    assert said(lambda: sarmitsuba.simulate(alone)) == []


@pytest.mark.parametrize(("prf", "enough"), [(1700.0, True), (1250.0, False)])
def test_a_prf_whose_ghosts_the_beam_holds_down_is_no_news(tmp_path: Path, prf: float, enough: bool) -> None:
    """A strip of 8 km by the shipped Sentinel-1-like radar: ambiguities of -24.8 dB at its prf of 1700 Hz.

    Loading and link budget agree: what one calls enough the other does, too.
    """
    path = tmp_path / "strip.xml"
    path.write_text(
        '<scene version="3.0.0"><shape type="rectangle"><bsdf type="radar_material">'
        '<string name="material" value="concrete"/><float name="rms_height" value="0.01"/></bsdf>'
        '<transform name="to_world"><scale value="4000"/></transform></shape></scene>'
    )
    parameters = {"image_extent_limit": "8000", "sar_antenna.prf": str(prf)}
    scene = []
    texts = said(
        lambda: scene.append(sarmitsuba.load_scene(path, radar="sentinel1_stripmap", parameters=parameters))
    )
    assert any("is below the Doppler bandwidth" in text for text in texts) == (not enough)
    found = {finding.name for finding in sarmitsuba.link_budget(scene[0]).impossible}
    assert ("doppler" in found) == (not enough)
