"""The image as the page shows it: decibels, layers, cursor, scale bar, two images, and focusing again by hand."""

import base64
from typing import Any

import numpy as np
import pytest

from sarmitsuba.signal.focusing import default_grid
from sarmitsuba.signal.focusing.focusers.backprojection import backproject
from sarmitsuba.signal.focusing.ideal import ideal_echoes, ideal_radar
from sarmitsuba.signal.image import ImageGrid, ShownAxes
from sarmitsuba.signal.metrics import coherence
from sarmitsuba.view.page.quantised_profiles import page_grid, page_profiles

SHOW = """
const { createImageView } = await import("sarmitsuba/image_view.js");
document.body.style = "margin: 0; background: #10151c; color: #eef3f8";
const stage = document.getElementById("stage");
stage.style = "height: 460px; width: 700px";
const layers = orders.map((order) => ({ order, re: data[`re${order}`], im: data[`im${order}`] }));
window.picked = [];
window.view = createImageView(stage, {
  title: "Radar image", grid, image: { layers, scale: 4, cellArea: data.area },
  onPick: (pixel, point) => window.picked.push([pixel, point]),
});
"""
PIXELS = """
// a copy to read from: the page's own canvas is never read back
const copy = document.createElement("canvas");
[copy.width, copy.height] = [view.canvas.width, view.canvas.height];
const context = copy.getContext("2d", { willReadFrequently: true });
context.drawImage(view.canvas, 0, 0);
return Array.from(context.getImageData(0, 0, view.canvas.width, view.canvas.height).data);
"""


def a_grid(rows: int = 40, columns: int = 60, kind: str = "ground") -> ImageGrid:
    """Turned 30 degrees, half a metre by a third, not at the origin."""
    along = np.array([np.sin(0.5), np.cos(0.5), 0.0])
    return ImageGrid(
        kind="ground" if kind == "ground" else "slant",
        azimuth=0.5 * np.arange(rows) - 7.0,
        range=np.arange(columns) / 3.0 + (0.0 if kind == "ground" else 9990.0),
        origin=np.array([12.0, -5.0, 3.0]) if kind == "ground" else np.array([12.0, -5.0, 7000.0]),
        along=along,
        across=np.array([along[1], -along[0], 0.0]),
        height=3.0,
        offset=np.array([100.0, 200.0, 0.0]),
    )


def planes(rng: np.random.Generator, orders: tuple[int, ...], shape: tuple[int, ...]) -> dict[int, Any]:
    """A few bright pixels per order on weak clutter."""
    out = {}
    for order in orders:
        plane = 0.01 * (rng.normal(size=shape) + 1j * rng.normal(size=shape))
        plane.flat[rng.choice(plane.size, 30, replace=False)] += np.exp(2j * np.pi * rng.random(30))
        out[order] = plane.astype(np.complex64)
    return out


def payload(layers: dict[int, Any], area: Any) -> tuple[dict[str, Any], dict[str, Any]]:
    """Layers four times too large, as the view is told."""
    arrays = {}
    for order, plane in layers.items():
        arrays[f"re{order}"] = np.float32(4.0 * plane.real)
        arrays[f"im{order}"] = np.float32(4.0 * plane.imag)
    if area is None:
        return {"area": None}, arrays
    return {}, {**arrays, "area": np.float32(area)}


def grey(power: Any, black: float, white: float) -> Any:
    with np.errstate(divide="ignore"):
        db = 10.0 * np.log10(power)
    return 255.0 * np.clip((db - black) / (white - black), 0.0, 1.0)


@pytest.mark.parametrize("calibrated", [True, False])
def test_pixels_are_the_coherent_sum_of_the_layers_switched_on(calibrated: bool, bench: Any) -> None:
    rng = np.random.default_rng(7)
    grid = a_grid()
    layers = planes(rng, (1, 2, 3), grid.shape)
    area = rng.uniform(0.2, 2.0, grid.shape[1]) if calibrated else None
    bench.run(SHOW, data=payload(layers, area), grid=page_grid(grid), orders=[1, 2, 3])
    bench.run("view.setRange(-35, 3);")
    for off in (None, 2):
        if off is not None:
            bench.page.get_by_label(f"{off} bounces").click()
        got = np.array(bench.run(PIXELS)).reshape(*grid.shape, 4)
        power = np.abs(sum(plane for order, plane in layers.items() if order != off)) ** 2
        want = grey(power / (1.0 if area is None else area), -35.0, 3.0)
        assert np.abs(got[..., 0] - want).max() <= 1.01  # tol: whole grey levels
        assert (got[..., :3] == got[..., :1]).all() and (got[..., 3] == 255).all()
        assert 20 < np.unique(got[..., 0]).size


def test_label_below_a_narrow_picture_is_whole(bench: Any) -> None:
    grid = a_grid(rows=400, columns=30)
    bench.run(
        SHOW,
        data=payload(planes(np.random.default_rng(1), (1,), grid.shape), None),
        grid=page_grid(grid),
        orders=[1],
    )
    left, right, width = bench.run(
        "await new Promise((done) => requestAnimationFrame(done)); return [...view.labelEnds, view.stage.clientWidth];"
    )
    assert bench.run("return view.box.width;") < right - left  # the picture is narrower than its label
    assert 0.0 <= left < right <= width


def test_the_slider_sets_the_levels(bench: Any) -> None:
    grid = a_grid()
    layers = planes(np.random.default_rng(8), (0,), grid.shape)
    bench.run(SHOW, data=payload(layers, None), grid=page_grid(grid), orders=[0])
    assert bench.page.get_by_role("group", name="Echoes of").count() == 0  # nothing to switch
    bench.page.get_by_label("Brightest").fill("-4")
    bench.page.get_by_label("Shown below it").fill("25")
    got = np.array(bench.run(PIXELS)).reshape(*grid.shape, 4)[..., 0]
    assert np.abs(got - grey(np.abs(layers[0]) ** 2, -29.0, -4.0)).max() <= 1.01  # tol: whole grey levels


@pytest.mark.parametrize("kind", ["ground", "slant"])
def test_the_cursor_says_where_it_stands(kind: str, bench: Any) -> None:
    grid = a_grid(kind=kind)
    layers = planes(np.random.default_rng(9), (0,), grid.shape)
    bench.run(SHOW, data=payload(layers, None), grid=page_grid(grid), orders=[0])
    row, column = 31, 11
    box = bench.page.get_by_role("application").bounding_box()
    x = box["x"] + (column + 0.5) / grid.shape[1] * box["width"]
    # flight is upwards
    y = box["y"] + (1.0 - (row + 0.5) / grid.shape[0]) * box["height"]
    bench.page.mouse.move(x, y)
    point = grid.positions()[row, column] + grid.offset
    level = 20.0 * np.log10(np.abs(layers[0][row, column]))
    said = bench.page.locator(".sar-readout").inner_text()
    assert f"x {point[0]:.1f} m, y {point[1]:.1f} m" in said
    across, up = ShownAxes.of(grid).shown(grid.azimuth[row], grid.range[column])
    since = " from the scene's origin" if kind == "ground" else ""
    assert f"azimuth{since} {up:.1f} m, {kind} range{since} {across:.1f} m" in said
    assert f"RCS {level:.1f} dBm²" in said
    bench.page.mouse.click(x, y)
    # by keys: two to the right, ten down
    bench.page.get_by_role("application").press("ArrowRight")
    bench.page.get_by_role("application").press("ArrowRight")
    bench.page.get_by_role("application").press("Shift+ArrowDown")
    bench.page.get_by_role("application").press("Enter")
    (first, place), (second, _) = bench.run("return window.picked;")
    assert first == {"row": row, "column": column}
    assert second == {"row": row - 10, "column": column + 2}
    np.testing.assert_allclose(place, point, atol=1e-6)  # tol: float64 about the image's centre
    assert bench.run("return view.pixelOf(place);", place=point.tolist()) == first
    outside = point + 40.0 * grid.across
    assert bench.run("return view.pixelOf(place);", place=outside.tolist()) is None


def test_proportions_and_scale_bar_are_true(bench: Any) -> None:
    grid = a_grid(30, 90)  # 15 m by 30 m
    layers = planes(np.random.default_rng(10), (0,), grid.shape)
    bench.run(SHOW, data=payload(layers, None), grid=page_grid(grid), orders=[0])
    box = bench.page.get_by_role("application").bounding_box()
    assert box["width"] / box["height"] == pytest.approx(2.0, rel=0.01)  # tol: CSS pixels
    assert bench.run("return view.perMetre;") * 30.0 == pytest.approx(box["width"], rel=0.01)  # tol: the same
    # white pixels of the bar's line, on the drawing above the picture
    length = bench.run(
        """
    const { left, top, height } = view.box;
    const ratio = view.drawing.width / view.stage.clientWidth;
    const row = Math.round((top + height - 12 + 1) * ratio);
    const line = view.drawing.getContext("2d").getImageData(0, row, view.drawing.width, 1).data;
    let n = 0;
    for (let i = 0; i < line.length; i += 4) n += line[i] > 200 && line[i + 3] > 200 ? 1 : 0;
    return [n / ratio, view.scaleBar * view.perMetre];
    """
    )
    assert length[0] == pytest.approx(length[1], abs=3.0)  # tol: ends on CSS pixels
    assert bench.run("return view.scaleBar;") in (5, 10)


PAIR = """
const { createComparison } = await import("sarmitsuba/compare.js");
document.body.style = "margin: 0; background: #10151c; color: #eef3f8";
const stage = document.getElementById("stage");
stage.style = "height: 700px";
const image = (name) => ({ layers: [{ order: 0, re: data[`${name}re`], im: data[`${name}im`] }], cellArea: null });
window.pair = createComparison(stage, {
  first: { title: "One", grid, image: image("a") }, second: { title: "Two", grid: other ?? grid, image: image("b") },
});
pair.first.setRange(-40, 0);
pair.second.setRange(-40, 0);
"""
FIRST = "const view = pair.first;" + PIXELS


def two(rng: np.random.Generator, shape: tuple[int, ...]) -> tuple[Any, Any, Any]:
    a = planes(rng, (0,), shape)[0]
    b = (0.7 * a + planes(rng, (0,), shape)[0]).astype(np.complex64)
    arrays = {f"{name}{part}": getattr(z, full) for name, z in (("a", a), ("b", b)) for part, full in PARTS}
    return a, b, ({}, {name: np.ascontiguousarray(value) for name, value in arrays.items()})


PARTS = (("re", "real"), ("im", "imag"))


def test_two_images_and_their_difference(bench: Any) -> None:
    grid = a_grid()
    a, b, data = two(np.random.default_rng(11), grid.shape)
    bench.run(PAIR, data=data, grid=page_grid(grid), other=None)
    text = bench.page.locator(".sar-pair > p").inner_text()
    error = 10.0 * np.log10(np.sum(np.abs(a - b) ** 2) / np.sum(np.abs(a) ** 2))
    assert f"Coherence {coherence(a, b):.4f}; the difference has {error:.1f} dB" in text

    # one cursor in both
    bench.run("pair.first.moved({ row: 17, column: 41 });")
    assert bench.run("return pair.second.cursor;") == {"row": 17, "column": 41}
    said = bench.page.locator(".sar-readout").first.inner_text()
    assert (
        f"{20.0 * np.log10(abs(a[17, 41])):.1f} dBm²; Two {20.0 * np.log10(abs(b[17, 41])):.1f} dBm²" in said
    )

    bench.page.get_by_label("Complex difference").check()
    got = np.array(bench.run(FIRST)).reshape(*grid.shape, 4)[..., 0]
    assert np.abs(got - grey(np.abs(a - b) ** 2, -40.0, 0.0)).max() <= 1.01  # tol: whole grey levels
    assert bench.page.locator("figcaption").first.inner_text() == "One minus Two"

    bench.page.get_by_label("Difference in dB").check()
    got = np.array(bench.run(FIRST)).reshape(*grid.shape, 4).astype(int)
    ratio = 20.0 * np.log10(np.abs(a) / np.abs(b))
    lit = np.maximum(np.abs(a), np.abs(b)) > 1e-2 * 1.01
    orange, blue = got[..., 0] > got[..., 2] + 20, got[..., 2] > got[..., 0] + 20
    assert orange[lit & (ratio > 3.0)].all() and blue[lit & (ratio < -3.0)].all()
    assert (lit & orange).any() and (lit & blue).any()
    dark = np.maximum(np.abs(a), np.abs(b)) < 1e-2 * 0.99
    assert dark.any() and (got[dark][:, :3] == 0).all()


def test_flicker_shows_one_then_the_other(bench: Any) -> None:
    grid = a_grid()
    a, b, data = two(np.random.default_rng(12), grid.shape)
    bench.page.emulate_media(reduced_motion="reduce")  # nothing blinks by itself then
    bench.run(PAIR, data=data, grid=page_grid(grid), other=None)
    bench.page.get_by_label("Flicker").check()
    for title, plane, button in (("One", a, "Show Two"), ("Two", b, "Show One"), ("One", a, "Show Two")):
        assert bench.page.locator("figcaption").first.inner_text() == title
        got = np.array(bench.run(FIRST)).reshape(*grid.shape, 4)[..., 0]
        assert np.abs(got - grey(np.abs(plane) ** 2, -40.0, 0.0)).max() <= 1.01  # tol: whole grey levels
        bench.page.get_by_role("button", name=button).click()


def test_flicker_goes_by_itself_where_motion_is_welcome(bench: Any) -> None:
    grid = a_grid()
    _, _, data = two(np.random.default_rng(13), grid.shape)
    bench.page.emulate_media(reduced_motion="no-preference")
    bench.run(PAIR, data=data, grid=page_grid(grid), other=None)
    bench.page.get_by_label("Flicker").check()
    for title in ("Two", "One", "Two"):
        bench.page.wait_for_function(f"pair.first.caption.textContent === '{title}'")


def test_images_of_other_pixels_have_one_scale_and_a_difference_in_db(bench: Any) -> None:
    grid, other = a_grid(), a_grid(50, 30)
    rng = np.random.default_rng(14)
    a, b = planes(rng, (0,), grid.shape)[0], planes(rng, (0,), other.shape)[0]
    arrays = {
        "are": a.real.copy(),
        "aim": a.imag.copy(),
        "bre": b.real.copy(),
        "bim": b.imag.copy(),
    }
    bench.run(PAIR, data=({}, arrays), grid=page_grid(grid), other=page_grid(other))
    bench.run("pair.first.moved({ row: 20, column: 12 });")
    assert bench.run("return pair.second.cursor;") == {"row": 20, "column": 12}
    bench.run("pair.first.moved({ row: 20, column: 45 });")
    assert bench.run("return pair.second.cursor;") is None
    assert "not imaged" in bench.page.locator(".sar-readout").first.inner_text()
    bench.page.get_by_label("Complex difference").check()
    assert "complex difference cannot be shown" in bench.page.locator(".sar-pair > p").inner_text()
    # the smaller scale of both, 25 m by 10 m and 20 m by 20 m beside each other
    scales = bench.run(
        "return [pair.first, pair.second].map((view) => [view.perMetre, view.fittingPerMetre]);"
    )
    assert scales[0][0] == scales[1][0] == min(fitting for _, fitting in scales)
    bench.page.get_by_label("Difference in dB").check()
    assert "same places of the ground" in bench.page.locator(".sar-pair > p").inner_text()
    got = np.array(bench.run(FIRST)).reshape(*grid.shape, 4).astype(int)
    # both grids start at one pixel and have one spacing: the second covers the first 30 columns
    ratio = 20.0 * np.log10(np.abs(a[:, :30]) / np.abs(b[:40]))
    lit = np.maximum(np.abs(a[:, :30]), np.abs(b[:40])) > 1e-2 * 1.01
    orange, blue = got[:, :30, 0] > got[:, :30, 2] + 20, got[:, :30, 2] > got[:, :30, 0] + 20
    assert orange[lit & (ratio > 3.0)].all() and blue[lit & (ratio < -3.0)].all()
    assert (got[:, 31:, :3] == 0).all()  # not imaged by the second


REFOCUS = """
const { createRefocus } = await import("sarmitsuba/refocus.js");
window.seen = [];
window.refocus = createRefocus(document.getElementById("stage"), {
  data, grid, onImage: (sum, facts) => { window.sum = sum; window.seen.push(facts); },
});
window.packed = () => ({ re: pack(sum.re), im: pack(sum.im), seen });
"""


def test_focusing_again_by_hand(bench: Any) -> None:
    radar = ideal_radar(n_samples=200)
    raw = ideal_echoes(radar, [[3.0, -4.0, 0.0], [-9.0, 12.0, 0.0]], [2.0, 1.0])
    grid = default_grid(raw, {"grid": "ground", "extent_azimuth": 60.0, "extent_range": 60.0})
    bench.run(REFOCUS, data=page_profiles(raw, grid).payload(), grid=page_grid(grid))

    def image() -> Any:
        out = bench.run("await refocus.running; return packed();")
        parts = [np.frombuffer(base64.b64decode(out[part]), dtype=np.float32) for part in ("re", "im")]
        return (parts[0] + 1j * parts[1]).reshape(grid.shape), out["seen"]

    bench.page.get_by_label("Window over the aperture").select_option("hamming:0.54")
    got, seen = image()
    want = backproject(raw, grid, azimuth_window="hamming")[0]
    # tol: as the backprojection's own tests
    assert abs(coherence(got, want)) > 0.9995
    assert seen[-1] == {"preview": False, "done": radar.track.n_pulses, "end": radar.track.n_pulses}
    # it grew: pulse by pulse is how it comes
    assert len(seen) > 1 and seen[0]["done"] < radar.track.n_pulses

    # back to what was recorded, by the button; then the time line stops half-way, then goes back
    bench.page.get_by_role("button", name="As it was").click()
    full, _ = image()
    assert abs(coherence(full, backproject(raw, grid)[0])) > 0.9995
    for end in (120, 40):
        bench.run("await refocus.setEnd(end);", end=end)
        got, seen = image()
        part = raw.data.copy()
        part[:, end:] = 0.0
        zeroed = type(raw)(part, raw.layers, raw.domain, radar)
        assert seen[-1]["done"] == end
        assert abs(coherence(got, backproject(zeroed, grid)[0])) > 0.9995


def test_a_moving_slider_shows_a_coarser_picture(bench: Any) -> None:
    radar = ideal_radar(n_samples=400)
    raw = ideal_echoes(radar, [[3.0, -4.0, 0.0], [-9.0, 12.0, 0.0]], [2.0, 1.0])
    request = {
        "grid": "ground",
        "extent_azimuth": 80.0,
        "extent_range": 80.0,
        "spacing_azimuth": 0.25,
        "spacing_range": 0.25,
    }
    grid = default_grid(raw, request)
    bench.run(REFOCUS, data=page_profiles(raw, grid).payload(), grid=page_grid(grid))
    out = bench.run("await refocus.change({ to: 0.5 }, false); return packed();")
    n = radar.track.n_pulses
    assert out["seen"] == [{"preview": True, "done": n, "end": n}]
    parts = [np.frombuffer(base64.b64decode(out[part]), dtype=np.float32) for part in ("re", "im")]
    got = (parts[0] + 1j * parts[1]).reshape(grid.shape)
    half = type(raw)(
        np.where(np.arange(n)[:, None] < round(n / 2), raw.data, 0.0), raw.layers, raw.domain, radar
    )
    step = int(np.ceil(np.sqrt(got.size / 65536)))
    assert step > 1
    rows, columns = (np.arange(size) // step * step for size in grid.shape)
    want = backproject(half, grid)[0][np.ix_(rows, columns)]
    assert abs(coherence(got, want)) > 0.9995


def test_what_the_aperture_can_do_is_said(bench: Any) -> None:
    """Cells and the place of ambiguities, by the textbook's formulas."""
    radar = ideal_radar(n_samples=200, slant_range=8e3, resolution=0.8, bandwidth=200e6)
    raw = ideal_echoes(radar, [0.0, 0.0, 0.0])
    grid = default_grid(raw, {"grid": "ground", "extent_azimuth": 30.0, "extent_range": 30.0})
    script = """
    const { apertureFacts } = await import("sarmitsuba/aperture.js");
    return apertureFacts(data, settings);
    """
    settings = {"keepEvery": 2, "from": 0.25, "to": 0.75, "rangeWindow": "hamming:0.54"}
    data = page_profiles(raw, grid).payload()
    got = bench.run(script, data=data, settings=settings)
    step = 2.0 * float(np.linalg.norm(np.diff(radar.track.position[:2], axis=0)))
    wavelength, length = radar.waveform.wavelength, got["pulses"] * step
    assert got["pulses"] == pytest.approx(radar.track.n_pulses / 4, abs=1)
    # tol: the angle is the length over the range to second order in their ratio, 2e-4 here
    assert got["azimuth"] == pytest.approx(wavelength * 8e3 / (2.0 * length), rel=1e-3)
    assert got["apart"] == pytest.approx(wavelength * 8e3 / (2.0 * step), rel=1e-3)
    # noise-equivalent width of Hamming's window, 1.36 cells
    assert got["range"] == pytest.approx(
        radar.waveform.range_cell * (0.54**2 + 0.46**2 / 2) / 0.54**2, rel=1e-4
    )
    whole = bench.run(script, data=data, settings={})
    assert whole["azimuth"] == pytest.approx(0.8, rel=0.01)  # tol: a whole number of pulses
