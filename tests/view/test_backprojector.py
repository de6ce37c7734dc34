"""The browser's backprojection against ours and against plain arithmetic, on exact echoes of points."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from sarmitsuba.core.errors import DataError
from sarmitsuba.loading.build import build_scene
from sarmitsuba.radar.description import RadarDescription
from sarmitsuba.radar.film import FilmDescription
from sarmitsuba.scene.geometry import PointTarget
from sarmitsuba.signal.focusing import default_grid
from sarmitsuba.signal.focusing.focusers.backprojection import backproject
from sarmitsuba.signal.focusing.ideal import ideal_echoes, ideal_radar
from sarmitsuba.signal.focusing.windows import parse_window
from sarmitsuba.signal.image import ImageGrid
from sarmitsuba.signal.metrics import coherence
from sarmitsuba.signal.raw_data import RawData
from sarmitsuba.view.page.quantised_profiles import page_center, page_grid, page_profiles

FOCUS = """
const { createBackprojector } = await import("sarmitsuba/backprojector.js");
const bp = await createBackprojector(null, data, grid, device);
bp.reset(settings);
bp.addAll();
const { re, im } = await bp.read();
return { re: pack(re), im: pack(im), device: bp.device };
"""


@dataclass(frozen=True)
class Look:
    """A radar, its echoes of some points and where to focus them."""

    raw: RawData
    grid: ImageGrid


def drawn(seed: int, cells: float = 90.0, **changes: Any) -> Look:
    """Points seen by a radar of drawn heading, look, squint, side, band; ``changes`` replace what is drawn.

    The image is ``cells`` azimuth cells wide.
    """
    rng = np.random.default_rng(seed)
    frequency = rng.choice([1.3e9, 5.4e9, 9.65e9, 16.7e9])
    resolution = rng.uniform(0.5, 1.2) if frequency > 2e9 else 2.5
    values: dict[str, Any] = {
        "mode": "spotlight",
        "slant_range": rng.uniform(4e3, 15e3),
        "look_angle_deg": rng.uniform(25.0, 60.0),
        "heading_deg": rng.uniform(0.0, 360.0),
        "squint_angle_deg": rng.uniform(-8.0, 8.0),
        "look_side": rng.choice(["left", "right"]),
        "center_frequency": frequency,
        "bandwidth": 150e6 / resolution,
        "azimuth_resolution": resolution,
        **changes,
    }
    extent = cells * values["azimuth_resolution"]
    film = FilmDescription(
        image_grid=rng.choice(["slant", "ground"]), image_extent_azimuth=extent, image_extent_range=extent
    )
    radar = RadarDescription(**values)
    points = np.column_stack([rng.uniform(-0.4 * extent, 0.4 * extent, (10, 2)), rng.uniform(0.0, 4.0, 10)])
    # the scene's own frame is about its points: put one at the aim
    targets = [PointTarget(f"p{i}", point, 1.0) for i, point in enumerate(points)]
    scene = build_scene(points=targets, radar=replace(radar, aim_x=0.0, aim_y=0.0, aim_z=0.0), film=film)
    raw = ideal_echoes(
        scene.radar, points - scene.offset, rng.uniform(0.3, 3.0, 10), rng.uniform(0.0, 6.3, 10)
    )
    return Look(raw, default_grid(scene.radar, scene.image))


STRIPMAP = {
    "mode": "stripmap",
    "squint_angle_deg": 0.0,
    "center_frequency": 9.65e9,
    "pattern": "rectangular",
    "azimuth_beamwidth_deg": 1.5,
    "elevation_beamwidth_deg": 6.0,
    "slant_range": 6e3,
    "azimuth_resolution": 1.0,
}
SPACE = {"slant_range": 700e3, "speed": 7500.0, "azimuth_resolution": 1.5, "center_frequency": 9.65e9}


@pytest.fixture
def in_browser(bench: Any, floats: Any) -> Any:
    """Image of a look in the browser, with settings of aperture.js."""

    def image(look: Look, device: str = "gpu", **settings: Any) -> Any:
        out = bench.run(
            FOCUS,
            data=page_profiles(
                look.raw,
                look.grid,
                range_window=settings.get("rangeWindow", "rectangular"),
                azimuth_window=settings.get("azimuthWindow", "rectangular"),
            ).payload(),
            grid=page_grid(look.grid),
            device=device,
            settings=settings,
        )
        assert out["device"] == device
        return floats(out["re"], look.grid.shape) + 1j * floats(out["im"], look.grid.shape)

    return image


def check(got: Any, want: Any, least: float = 0.9995) -> None:
    """Same shape and same level: coherence, and the power to 0.05 dB."""
    # tol: four-tap interpolation -56 dB, int16, crop of the records' side lobes: together below -40 dB
    assert abs(coherence(got, want)) >= least
    # tol: the same
    assert abs(20.0 * np.log10(np.linalg.norm(got) / np.linalg.norm(want))) < 0.05


def ours(raw: RawData, grid: ImageGrid, **windows: str) -> Any:
    """Our backprojection of the one layer there is."""
    return backproject(raw, grid, **windows)[0]


def kept(raw: RawData, pulses: Any) -> RawData:
    """Some of the pulses, as a radar that sent no others would have recorded them."""
    radar = raw.radar
    track, look, window = radar.track, radar.pointing, radar.window
    part = replace(
        radar,
        track=replace(
            track, time=track.time[pulses], position=track.position[pulses], velocity=track.velocity[pulses]
        ),
        pointing=replace(
            look,
            boresight=look.boresight[pulses],
            azimuth_axis=look.azimuth_axis[pulses],
            elevation_axis=look.elevation_axis[pulses],
        ),
        window=replace(window, start_range=window.start_range[pulses]),
    )
    return replace(raw, data=raw.data[:, pulses], radar=part)


CASES = {
    **{f"spotlight {seed}": (seed, {}) for seed in range(5)},
    "spotlight with a beam": (
        11,
        {"pattern": "gaussian", "azimuth_beamwidth_deg": 1.2, "elevation_beamwidth_deg": 1.6},
    ),
    "stripmap 12": (12, STRIPMAP),
    "stripmap 13": (13, {**STRIPMAP, "pattern": "gaussian", "slant_range": 4e3}),
    "from 700 km": (14, SPACE),
    "stripmap from 700 km": (
        15,
        {**STRIPMAP, **SPACE, "azimuth_beamwidth_deg": 0.3, "azimuth_resolution": 6.0, "cells": 40.0},
    ),
}

# the longest tracks; test_the_phase_is_kept_half_a_kilometre_from_the_centre holds what the distance asks for
LONG = {"stripmap 13", "from 700 km", "stripmap from 700 km"}


@pytest.mark.parametrize(
    ("case", "device"),
    [
        *(pytest.param(c, "gpu", marks=pytest.mark.slow if c in LONG else ()) for c in CASES),
        pytest.param("spotlight 0", "cpu", marks=pytest.mark.slow),
        *((case, "cpu") for case in ("spotlight with a beam", "stripmap 13", "from 700 km")),
    ],
)
def test_the_browsers_image_is_ours(case: str, device: str, in_browser: Any) -> None:
    seed, changes = CASES[case]
    look = drawn(seed, **changes)
    check(in_browser(look, device), ours(look.raw, look.grid))


def test_a_measured_beam_is_the_browsers_too(in_browser: Any, tmp_path: Path) -> None:
    lines = []
    for cut, width in (("azimuth", 1.5), ("elevation", 6.0)):
        angle = np.linspace(-3.0, 3.0, 121)
        lines += [f"{cut},{a * width:.6g},{-11.0 * a * a + 0.8 * a:.6g}" for a in angle]  # lopsided
    path = tmp_path / "beam.csv"
    path.write_text("\n".join(lines), encoding="utf-8")
    widths = {"azimuth_beamwidth_deg": 0.0, "elevation_beamwidth_deg": 0.0}
    look = drawn(16, 45.0, **{**STRIPMAP, **widths, "pattern": "table", "pattern_file": str(path)})
    for device in ("gpu", "cpu"):
        check(in_browser(look, device), ours(look.raw, look.grid))


@pytest.mark.parametrize(("case", "n"), [("spotlight 1", 2), ("spotlight 4", 3), ("stripmap 12", 4)])
def test_dropped_pulses_are_those_never_sent(case: str, n: int, in_browser: Any) -> None:
    seed, changes = CASES[case]
    look = drawn(seed, **changes)
    full = ours(look.raw, look.grid)
    want = ours(kept(look.raw, slice(None, None, n)), look.grid)
    # the comparison must see the ambiguities: without them it would hold for the whole aperture too
    assert abs(coherence(full, want)) < 0.99
    check(in_browser(look, keepEvery=n), want)


def test_a_shorter_aperture_is_that_of_the_pulses_left(in_browser: Any) -> None:
    look = drawn(2)
    n = look.raw.radar.track.n_pulses
    pulses = slice(round(0.2 * n), round(0.55 * n))
    want = ours(kept(look.raw, pulses), look.grid, azimuth_window="hamming")
    got = in_browser(look, **{"from": 0.2, "to": 0.55, "azimuthWindow": "hamming:0.54"})
    check(got, want)


def test_a_shorter_stripmap_aperture_is_a_narrower_band(in_browser: Any) -> None:
    look = drawn(12, 45.0, **STRIPMAP)
    radar = look.raw.radar
    narrow = replace(radar, half_aperture=0.5 * radar.half_aperture)
    want = ours(replace(look.raw, radar=narrow), look.grid)
    check(in_browser(look, **{"from": 0.25, "to": 0.75}), want)


@pytest.mark.parametrize(
    ("case", "names"),
    [
        ("spotlight 0", ("hamming:0.54", "taylor:4:-35")),
        ("spotlight 0", ("kaiser:3", "hann")),
        ("stripmap 12", ("taylor:4:-35", "hamming:0.54")),
    ],
)
def test_windows_are_ours(case: str, names: tuple[str, str], in_browser: Any) -> None:
    seed, changes = CASES[case]
    look = drawn(seed, **changes)
    azimuth, range_ = names
    want = ours(look.raw, look.grid, azimuth_window=azimuth, range_window=range_)
    check(in_browser(look, azimuthWindow=azimuth, rangeWindow=range_), want)


def test_the_page_starts_with_the_images_own_windows(bench: Any, floats: Any) -> None:
    look = drawn(0)
    windows = {"range_window": "taylor", "azimuth_window": "kaiser:4"}
    profiles = page_profiles(look.raw, look.grid, **windows)
    out = bench.run(FOCUS, data=profiles.payload(), grid=page_grid(look.grid), device="gpu", settings={})
    got = floats(out["re"], look.grid.shape) + 1j * floats(out["im"], look.grid.shape)
    check(got, ours(look.raw, look.grid, **windows))
    assert abs(coherence(got, ours(look.raw, look.grid))) < 0.99


def test_window_functions_are_ours(bench: Any) -> None:
    look = drawn(0)
    u = np.random.default_rng(3).uniform(-0.55, 0.55, 200)
    data = page_profiles(
        look.raw, look.grid, range_window="taylor:6:-40", azimuth_window="hamming:0.6"
    ).payload()
    script = """
    const m = await import("sarmitsuba/windows.js");
    return Object.fromEntries(m.windowNames(data).map((text) => [text, u.map(m.windowOf(data, text))]));
    """
    found = bench.run(script, data=data, u=u.tolist())
    assert list(found) == ["taylor:6:-40", "hamming:0.6", "rectangular", "taylor:4:-35", "hamming:0.54"]
    for name, got in found.items():
        # tol: linear between 1025 nodes, w'' / 8 of their distance squared
        np.testing.assert_allclose(got, parse_window(name)(u), atol=2e-5)


@pytest.mark.parametrize(
    ("kind", "device"),
    [("linear", "gpu"), ("quadratic", "cpu"), ("sinusoidal", "gpu"), ("sinusoidal", "cpu")],
)
def test_a_track_error_is_a_track_recorded_wrongly(kind: str, device: str, in_browser: Any) -> None:
    look = drawn(3)
    radar = look.raw.radar
    position, center = radar.track.position, page_center(look.grid)
    u = np.linspace(-1.0, 1.0, radar.track.n_pulses)
    amplitude = 0.2 * radar.waveform.wavelength
    error = amplitude * {"linear": u, "quadratic": u**2, "sinusoidal": np.sin(2.5 * np.pi * u)}[kind]
    line = position - center
    moved = position + error[:, None] * line / np.linalg.norm(line, axis=1, keepdims=True)
    wrong = replace(look.raw, radar=replace(radar, track=replace(radar.track, position=moved)))
    want = ours(wrong, look.grid)
    # it is no small thing
    assert abs(coherence(ours(look.raw, look.grid), want)) < 0.95
    check(in_browser(look, device, error={"kind": kind, "amplitude": amplitude, "cycles": 2.5}), want)


def test_an_image_beyond_the_record_is_zero_there_as_ours_is(in_browser: Any) -> None:
    radar = ideal_radar(n_samples=90)
    raw = ideal_echoes(radar, [[3.0, -4.0, 0.0], [-9.0, 12.0, 0.0]], [2.0, 1.0])
    look = Look(raw, default_grid(raw, {"grid": "slant", "extent_azimuth": 40.0, "extent_range": 220.0}))
    want = ours(raw, look.grid)
    assert (want == 0.0).any(axis=0).any()
    for device in ("gpu", "cpu"):
        got = in_browser(look, device)
        assert ((got == 0.0) == (want == 0.0)).mean() > 0.99  # tol: pixels on the record's very end
        check(got, want)


def test_pulse_by_pulse_ends_where_all_at_once_does(bench: Any) -> None:
    """Half-way the image is that of half the pulses."""
    look = drawn(4)
    script = """
    const { createBackprojector } = await import("sarmitsuba/backprojector.js");
    const bp = await createBackprojector(null, data, grid, "gpu");
    const half = data.nPulses >> 1;
    const power = ({ re, im }) => re.reduce((sum, value, i) => sum + value ** 2 + im[i] ** 2, 0);
    const difference = (a, b) =>
      power({ re: a.re.map((v, i) => v - b.re[i]), im: a.im.map((v, i) => v - b.im[i]) }) / power(a);
    for (let t = 0; t < half; t++) bp.add(t, t + 1);
    const partly = await bp.read();
    for (let t = half; t < data.nPulses; t += 3) bp.add(t, Math.min(t + 3, data.nPulses));
    const steps = await bp.read();
    bp.reset();
    bp.add(0, half);
    const first = await bp.read();
    bp.reset();
    bp.addAll();
    const whole = await bp.read();
    return [difference(first, partly), difference(whole, steps), difference(whole, partly)];
    """
    grid = page_grid(look.grid)
    half, whole, other = bench.run(script, data=page_profiles(look.raw, look.grid).payload(), grid=grid)
    assert max(half, whole) < 1e-10  # tol: float32 sums, squared
    assert other > 0.1


@pytest.mark.parametrize("distance", [5e3, 700e3])
def test_the_phase_is_kept_half_a_kilometre_from_the_centre(distance: float, bench: Any, floats: Any) -> None:
    """One pulse that is constant over range: a pixel's phase is that of its distance, in extended precision."""
    n, wavelength = 96, 0.031
    rng = np.random.default_rng(int(distance))
    look, heading = np.radians(38.0), np.radians(rng.uniform(0.0, 360.0))
    antenna = distance * np.array(
        [np.sin(look) * np.cos(heading), np.sin(look) * np.sin(heading), np.cos(look)]
    )
    axis = rng.uniform(-1.0, 1.0) + np.linspace(-500.0, 498.0, n)
    along, across = [0.6, 0.8, 0.0], [0.8, -0.6, 0.0]
    header = {
        "wavelength": wavelength,
        "nPulses": 1,
        "nBins": 400,
        "binSpacing": 10.0,
        "bandFraction": 0.8,
        "beam": None,
        "band": None,
        "scale": None,
    }
    reference = np.linalg.norm(antenna)
    arrays = {
        "antenna": antenna[None],
        "referenceRange": np.array([reference]),
        "firstBin": np.array([-2000.0]),
        "profiles": np.tile(np.array([1.0, 0.0], dtype=np.float32), (1, 400, 1)),
        "weights": np.ones(1, dtype=np.float32),
    }
    grid = (
        {"nx": n, "ny": n, "origin": [0.0, 0.0, 1.5], "along": along, "across": across},
        {"rows": axis, "columns": axis},
    )
    out = bench.run(FOCUS, data=(header, arrays), grid=grid, device="gpu", settings={})
    got = floats(out["re"], (n, n)) + 1j * floats(out["im"], (n, n))
    points = (
        np.array([0.0, 0.0, 1.5]) + axis[:, None, None] * np.array(along) + axis[:, None] * np.array(across)
    )
    delta = points.astype(np.longdouble) - antenna.astype(np.longdouble)
    path = np.sqrt((delta**2).sum(axis=-1)) - np.sqrt((antenna.astype(np.longdouble) ** 2).sum())
    turns = 2.0 * path / np.longdouble(wavelength)
    want = np.exp(2j * np.pi * (turns - np.round(turns)).astype(np.float64))
    error = np.angle(got * want.conj())
    assert np.abs(error).max() < 1e-3  # tol: float32 of a pixel's offset from its block's middle


def test_without_float_textures_the_cpu_does_it(bench: Any) -> None:
    look = drawn(0)
    script = """
    OffscreenCanvas.prototype.getContext = () => null;
    const { createBackprojector } = await import("sarmitsuba/backprojector.js");
    const words = await createBackprojector(null, data, grid, "gpu").catch((error) => error.message);
    return [(await createBackprojector(null, data, grid)).device, words];
    """
    payload, grid = page_profiles(look.raw, look.grid).payload(), page_grid(look.grid)
    device, words = bench.run(script, data=payload, grid=grid)
    assert device == "cpu"
    assert "no WebGL2 with float textures" in words


def test_a_window_or_error_that_is_not_there_is_said(bench: Any) -> None:
    for module, call, text in (
        ("windows.js", "windowOf({}, 'flat')", "window flat: not in this page; choose one of rectangular"),
        ("aperture.js", "makeTrackError(3, { kind: 'cubic', amplitude: 1 })", "track error cubic: unknown"),
    ):
        script = f"const m = await import('sarmitsuba/{module}'); try {{ m.{call}; }} catch (e) {{ return e.message; }}"
        assert text in bench.run(script)


def test_quantised_profiles_are_the_recorded_ones() -> None:
    """By the formula of the class, from the raw data alone."""
    radar = ideal_radar(n_samples=400)
    raw = ideal_echoes(radar, [[3.0, -4.0, 1.0], [-9.0, 12.0, 0.0]], [2.0, 1.0])
    look = Look(raw, default_grid(raw, {"grid": "slant", "extent_azimuth": 40.0, "extent_range": 50.0}))
    one = page_profiles(raw, look.grid)
    assert one.samples.shape[1] < radar.window.n_samples  # something was cut
    for t in (0, radar.track.n_pulses // 2, radar.track.n_pulses - 1):
        line = radar.track.position[t] - page_center(look.grid)
        reference = np.linalg.norm(line)
        place = (one.first_bin[t] + reference - radar.window.start_range[t]) / radar.window.sample_spacing
        first = round(place)
        assert abs(place - first) < 1e-6  # tol: float64 of a range over the sample spacing
        phase = np.exp(4j * np.pi * reference / radar.waveform.wavelength)
        raw = look.raw.data[0, t, first : first + one.samples.shape[1]].astype(np.complex128)
        want = raw * reference**2 / radar.amplitude_constant * phase
        got = (one.samples[t, :, 0] + 1j * one.samples[t, :, 1]) * float(one.scale[t])
        # tol: half a step in each part
        assert np.abs(got - want).max() <= 0.51 * np.sqrt(2.0) * one.scale[t]
        assert np.abs(want).max() < 2.0**15 * np.sqrt(2.0) * one.scale[t]


def test_what_cannot_be_shown_is_said() -> None:
    look = drawn(0)
    with pytest.raises(DataError, match="not range compressed"):
        page_profiles(replace(look.raw, domain="chirped"), look.grid)
    with pytest.raises(DataError, match="no channel 'HV'"):
        page_profiles(look.raw, look.grid, "HV")
    away = replace(look.grid, origin=look.grid.origin + 3e4 * look.grid.across)
    with pytest.raises(DataError, match="no pulse recorded any range of the image"):
        page_profiles(look.raw, away)
