"""The page's functions that need no document, one by one in Node.js, against NumPy; and its sources in a linter."""

import html
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.interpolate import RegularGridInterpolator

import sarmitsuba.view.page
from sarmitsuba.radar.antenna import Antenna
from sarmitsuba.radar.pattern import PATTERNS, Pattern
from sarmitsuba.signal.focusing.windows import parse_window
from sarmitsuba.signal.image import ImageGrid, SarImage
from sarmitsuba.signal.raw_data import Layer
from sarmitsuba.view.page.paths import locate_on_plane
from sarmitsuba.view.page.payload import side_lobes
from sarmitsuba.view.page.quantised_profiles import page_grid, sample_beam
from sarmitsuba.view.page.write import Packer

WEB = Path(sarmitsuba.view.page.__file__).parent / "web"
Node = Callable[..., Any]


def flights(n: int, seed: int) -> dict[str, Any]:
    """Antennas above a plane, climbing ones too, and a point each."""
    rng = np.random.default_rng(seed)
    height = rng.normal(scale=100.0, size=n)
    position = np.column_stack([rng.normal(scale=1e3, size=(n, 2)), height + rng.uniform(1e3, 1e5, n)])
    velocity = np.column_stack([rng.normal(scale=100.0, size=(n, 2)), rng.normal(scale=10.0, size=n)])
    across = np.column_stack([velocity[:, 1], -velocity[:, 0], np.zeros(n)]) * rng.choice([-1, 1], (n, 1))
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    along = np.cross([0.0, 0.0, 1.0], across)
    beside = (position[:, 2] - height) * rng.uniform(0.5, 2.0, n)
    point = position + beside[:, None] * across + rng.normal(scale=5e2, size=(n, 1)) * along
    point[:, 2] = height + rng.uniform(0.0, 30.0, n)
    names = ("position", "velocity", "point", "height", "across", "along")
    values = (position, velocity, point, height, across, along)
    return dict(zip(names, values, strict=True))


# ---------------------------------------------------------------- sources


def test_sources_pass_the_linter() -> None:
    """Names that are nowhere, imports and variables without a use, shadows and the like; tests/view/oxlint.json."""
    program = shutil.which("oxlint", path=str(Path(sys.executable).parent)) or shutil.which("oxlint")
    if program is None:
        pytest.skip("oxlint is not installed; in the test extra")
    config = Path(__file__).parent / "oxlint.json"
    files = sorted(str(path) for path in WEB.glob("*.js"))
    run = subprocess.run([program, "-c", str(config), *files], capture_output=True, text=True)
    assert run.returncode == 0, run.stdout


# ---------------------------------------------------------------- image_math.js


def drawn_grid(rng: np.random.Generator, kind: str) -> ImageGrid:
    """A grid of drawn heading, place, spacing and, in slant range, look angle about one place of the scene."""
    heading, look = rng.uniform(0.0, 2.0 * np.pi), rng.uniform(0.5, 1.0)
    along = np.array([np.sin(heading), np.cos(heading), 0.0])
    across = np.array([along[1], -along[0], 0.0])
    rows, columns = (int(n) for n in rng.integers(30, 50, 2))
    azimuth = rng.uniform(0.4, 0.8) * (np.arange(rows) - rows / 2)
    steps = rng.uniform(0.4, 0.8) * (np.arange(columns) - columns / 2)
    place = np.array([*rng.uniform(-3.0, 3.0, 2), 2.0])
    slant = 9e3 / np.cos(look)
    origin = place if kind == "ground" else place - 9e3 * np.tan(look) * across + np.array([0.0, 0.0, 9e3])
    range_ = steps if kind == "ground" else slant + steps * np.sin(look)
    offset = np.array([100.0, -50.0, 0.0])
    return ImageGrid(
        "ground" if kind == "ground" else "slant", azimuth, range_, origin, along, across, 2.0, offset=offset
    )


def page_values(grid: ImageGrid) -> dict[str, Any]:
    header, arrays = page_grid(grid)
    return {**header, **{name: values.tolist() for name, values in arrays.items()}}


@pytest.mark.parametrize("kinds", [("ground", "ground"), ("slant", "slant"), ("slant", "ground")])
def test_values_at_the_pixels_of_another_image_are_those_of_the_same_ground(
    kinds: tuple[str, str], in_node: Node
) -> None:
    """Two images of drawn headings and look angles, against SciPy's interpolation at the pixels' scene positions."""
    rng = np.random.default_rng(21)
    script = """
    const { atPixelsOf } = await import("sarmitsuba/image_math.js");
    return atPixelsOf(Float32Array.from(values), own, other);
    """
    for _ in range(3):
        own, other = (drawn_grid(rng, kind) for kind in kinds)
        values = rng.uniform(size=own.shape)
        out = in_node(script, values=values.ravel().tolist(), own=page_values(own), other=page_values(other))
        got = np.array(out, dtype=np.float64).reshape(other.shape)
        away = other.positions() - own.origin * [1.0, 1.0, 0.0]
        place = np.stack([away @ own.along, away @ own.across], axis=-1)
        want = RegularGridInterpolator((own.azimuth, own.across_distance()), values, bounds_error=False)(
            place
        )
        inside = np.isfinite(want)
        assert 0.2 < inside.mean() < 1.0
        np.testing.assert_allclose(got[inside], want[inside], atol=1e-5)  # tol: float32 values
        # half a pixel more at the edges, and nothing beyond
        beyond = np.zeros(other.shape, dtype=bool)
        for axis, at in zip((own.azimuth, own.across_distance()), np.moveaxis(place, -1, 0), strict=True):
            first, last = axis[1] - axis[0], axis[-1] - axis[-2]
            beyond |= (at < axis[0] - 0.51 * first) | (at > axis[-1] + 0.51 * last)
        assert beyond.any() and np.isnan(got[beyond]).all()


def test_an_image_at_its_own_pixels_is_itself(in_node: Node) -> None:
    grid = drawn_grid(np.random.default_rng(22), "slant")
    values = np.random.default_rng(23).uniform(size=grid.shape).astype(np.float32)
    script = """
    const { atPixelsOf } = await import("sarmitsuba/image_math.js");
    return atPixelsOf(Float32Array.from(values), own, own);
    """
    got = in_node(script, values=values.ravel().tolist(), own=page_values(grid))
    np.testing.assert_allclose(
        np.reshape(got, grid.shape), values, atol=1e-5
    )  # tol: places of 9 km in float64


def test_axes_count_in_coordinates_of_the_scene_either_way(in_node: Node) -> None:
    """Numbers and labels are those of pictures; an axis that falls has its marks at the same pixels."""
    script = """
    const { axisTicks, lengthOf, perMetre } = await import("sarmitsuba/image_math.js");
    const ticks = [axisTicks(grid.range, 600, 70), axisTicks(grid.azimuth, 400, 45)];
    return [...ticks, lengthOf(grid.range), perMetre(grid, 600, 400)];
    """
    rows, columns = 0.5 * np.arange(61) - 15.0, 0.5 * np.arange(81) - 20.0
    offset = np.array([1000.0, 2000.0, 0.0])
    for turn in (1.0, -1.0):
        along, across = np.array([0.0, turn, 0.0]), np.array([turn, 0.0, 0.0])
        grid = ImageGrid(
            "ground", rows, columns, np.array([7.0, 3.0, 0.0]), along, across, 0.0, offset=offset
        )
        values = page_values(grid)
        assert values["axes"] == {
            "along": "y of the scene (m), azimuth",
            "across": "x of the scene (m), ground range",
        }
        points = grid.positions() + offset
        np.testing.assert_allclose(values["range"], points[0, :, 0], atol=1e-9)
        np.testing.assert_allclose(values["azimuth"], points[:, 0, 1], atol=1e-9)
        across_ticks, up_ticks, length, scale = in_node(script, grid=values)
        assert length == pytest.approx(40.5) and scale == pytest.approx(min(600 / 40.5, 400 / 30.5))
        for ticks, shown, size in ((across_ticks, points[0, :, 0], 600), (up_ticks, points[:, 0, 1], 400)):
            assert len(ticks) >= 3
            for tick in ticks:
                pixel = tick["place"] / size * len(shown) - 0.5
                at = np.interp(pixel, np.arange(len(shown)), shown)
                assert at == pytest.approx(tick["value"], abs=1e-6)
                assert tick["value"] % tick["step"] == pytest.approx(0.0, abs=1e-9)


# as much of a document as the comparison of two images asks for: elements 500 x 400 that keep their children
DOCUMENT = """
class Element {
  constructor(tag) {
    Object.assign(this, { tag, children: [], style: {}, hidden: false, clientWidth: 500, clientHeight: 400 });
    this.classList = { toggle() {}, add() {} };
  }
  append(...nodes) { this.children.push(...nodes.filter((node) => node instanceof Element)); }
  setAttribute(name, value) { this[name] = value; }
  addEventListener() {}
  querySelectorAll() {
    return this.children.flatMap((node) => [...(node.type === "radio" ? [node] : []), ...node.querySelectorAll()]);
  }
  getContext() {
    const image = (width, height) => ({ data: { buffer: new ArrayBuffer(4 * width * height) } });
    const known = { createImageData: image, measureText: (text) => ({ width: 6 * text.length }) };
    return new Proxy({}, { get: (_, name) => known[name] ?? (() => {}), set: () => true });
  }
}
const element = (tag) => new Element(tag);
globalThis.document = { createElement: element, getElementById: () => null, head: element("head") };
globalThis.window = { devicePixelRatio: 1 };
globalThis.getComputedStyle = () => ({});
globalThis.ResizeObserver = class { observe() {} };
globalThis.matchMedia = () => ({ matches: true });
"""


def test_two_looks_have_one_scale_and_a_difference_on_the_ground(in_node: Node) -> None:
    """Images of other extents and look angles: equal scales, and levels of the second at the first's pixels."""
    rng = np.random.default_rng(24)
    first, second = drawn_grid(rng, "slant"), drawn_grid(rng, "slant")
    amplitude = rng.uniform(0.5, 2.0, second.shape)
    script = (
        DOCUMENT
        + """
    const { createComparison } = await import("sarmitsuba/compare.js");
    const image = (values) => ({
      layers: [{ order: 0, re: Float32Array.from(values), im: new Float32Array(values.length) }], cellArea: null,
    });
    const pair = createComparison(element("div"), {
      first: { title: "One", grid: own, image: image(ones) },
      second: { title: "Two", grid: other, image: image(values) },
    });
    const scales = () => [pair.first, pair.second].map((view) => view.perMetre);
    const out = { side: scales(), fitting: [pair.first, pair.second].map((view) => view.fittingPerMetre) };
    for (const mode of ["ratio", "complex"]) {
      pair.setMode(mode);
      out[mode] = [pair.text.textContent, pair.holders[1].hidden, pair.first.perMetre];
    }
    return { ...out, levels: pair.secondDb };
    """
    )
    got = in_node(
        script,
        own=page_values(first),
        other=page_values(second),
        ones=np.ones(first.shape[0] * first.shape[1]).tolist(),
        values=amplitude.ravel().tolist(),
    )
    assert got["fitting"][0] != pytest.approx(got["fitting"][1], rel=0.005)
    assert got["side"] == [min(got["fitting"])] * 2
    text, alone, scale = got["ratio"]
    assert "same places of the ground" in text and alone and scale == got["fitting"][0]
    text, alone, scale = got["complex"]
    assert "complex difference cannot be shown" in text and not alone and scale == min(got["fitting"])
    away = first.positions() - second.origin * [1.0, 1.0, 0.0]
    place = np.stack([away @ second.along, away @ second.across], axis=-1)
    axes = (second.azimuth, second.across_distance())
    want = 10.0 * np.log10(RegularGridInterpolator(axes, amplitude**2, bounds_error=False)(place))
    levels = np.array(got["levels"], dtype=np.float64).reshape(first.shape)
    inside = np.isfinite(want)
    assert inside.mean() > 0.2
    np.testing.assert_allclose(levels[inside], want[inside], atol=1e-4)  # tol: float32 dB


# ---------------------------------------------------------------- localise.js


def test_range_and_rate_to_a_point_and_back(in_node: Node) -> None:
    drawn = flights(100, 1)
    drawn["point"][:, 2] = drawn["height"]
    script = """
    const { onPlane, rangeAndRate } = await import("sarmitsuba/localise.js");
    return position.map((p, i) => {
      const { range, rate } = rangeAndRate(p, velocity[i], point[i]);
      return { range, rate, found: onPlane(p, velocity[i], range, rate, height[i], across[i]),
        nearer: onPlane(p, velocity[i], 0.99 * (p[2] - height[i]), 0, height[i], across[i]) };
    });
    """
    given = {name: value.tolist() for name, value in drawn.items()}
    for i, got in enumerate(in_node(script, **given)):
        p, v, x = (drawn[name][i] for name in ("position", "velocity", "point"))
        assert got["range"] == pytest.approx(np.linalg.norm(p - x), rel=1e-12)
        assert got["rate"] == pytest.approx((p - x) @ v / np.linalg.norm(p - x), rel=1e-9, abs=1e-9)
        np.testing.assert_allclose(got["found"], x, rtol=0.0, atol=1e-4)  # tol: float64 over slant and ground
        ours = locate_on_plane(
            p, v, np.array([got["range"]]), np.array([got["rate"]]), x[2], drawn["across"][i]
        )
        np.testing.assert_allclose(got["found"], ours[0], rtol=0.0, atol=1e-6)
        assert got["nearer"] is None


def test_echoes_by_the_ground_land_at_their_range_and_rate(in_node: Node) -> None:
    drawn = flights(50, 2)
    script = """
    const { landings } = await import("sarmitsuba/localise.js");
    return position.map((p, i) =>
      landings(p, velocity[i], point[i], height[i] - 2, { height: height[i], across: across[i] }));
    """
    given = {name: value.tolist() for name, value in drawn.items()}
    for i, got in enumerate(in_node(script, **given)):
        p, v, x, h = (drawn[name][i] for name in ("position", "velocity", "point", "height"))
        ends = [x, np.array([x[0], x[1], 2.0 * (h - 2.0) - x[2]])]
        # half of the way there by one of them and back by one of them, and how fast it grows
        for landing, pair in zip(got, ((0, 0), (0, 1), (1, 1)), strict=True):
            ways = [p - ends[k] for k in pair]
            length = 0.5 * sum(np.linalg.norm(way) for way in ways)
            rate = 0.5 * sum(way @ v / np.linalg.norm(way) for way in ways)
            assert landing["range"] == pytest.approx(length, rel=1e-12)
            assert landing["rate"] == pytest.approx(rate, rel=1e-9, abs=1e-9)
            away = p - np.array(landing["point"])
            assert landing["point"][2] == h
            assert np.linalg.norm(away) == pytest.approx(length, rel=1e-9)
            assert away @ v / np.linalg.norm(away) == pytest.approx(rate, rel=1e-6, abs=1e-6)


@pytest.mark.parametrize("kind", ["slant", "ground"])
def test_pixels_and_points_of_the_plane(kind: str, in_node: Node) -> None:
    drawn = flights(20, 3)
    rng = np.random.default_rng(3)
    grids = [
        {
            "kind": kind,
            "origin": drawn["position"][i].tolist(),
            "height": drawn["height"][i],
            "along": drawn["along"][i].tolist(),
            "across": drawn["across"][i].tolist(),
            "azimuth": rng.uniform(0.5, 2.0, 2).tolist(),
            "range": [float(drawn["position"][i, 2] - drawn["height"][i] + 50.0), 0.7],
        }
        for i in range(20)
    ]
    at = rng.uniform(0.0, 300.0, (20, 2))
    script = """
    const { pixelOf, pointOf } = await import("sarmitsuba/localise.js");
    return grids.map((grid, i) => [pointOf(grid, at[i]), pixelOf(grid, pointOf(grid, at[i]))]);
    """
    for grid, where, (point, back) in zip(
        grids, at, in_node(script, grids=grids, at=at.tolist()), strict=True
    ):
        np.testing.assert_allclose(back, where, rtol=0.0, atol=1e-5)  # tol: float64 over slant and ground
        away = np.array(point) - grid["origin"]
        azimuth, reach = (
            grid[name][0] + k * grid[name][1] for name, k in (("azimuth", where[0]), ("range", where[1]))
        )
        assert away @ grid["along"] == pytest.approx(azimuth, abs=1e-6)
        level = away @ grid["across"]
        got = np.hypot(level, away[2]) if kind == "slant" else level
        assert point[2] == grid["height"] and got == pytest.approx(reach, rel=1e-9)


def test_a_beams_outline_is_its_half_power_ellipse(in_node: Node) -> None:
    rng = np.random.default_rng(4)
    axes, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    axes[0] *= -np.sign(axes[0, 2])
    widths, position, most = [0.3, 0.9], [10.0, -20.0, 500.0], 2e3
    script = """
    const { footprint } = await import("sarmitsuba/localise.js");
    return footprint(position, axes, widths, -3, most);
    """
    got = np.array(in_node(script, position=position, axes=axes.tolist(), widths=widths, most=most))
    ray = got - position
    boresight, azimuth, elevation = (ray @ axis for axis in axes)
    ellipse = np.hypot(azimuth / np.tan(0.15), elevation / np.tan(0.45))
    np.testing.assert_allclose(ellipse, boresight, rtol=1e-12)
    on_ground = np.abs(got[:, 2] + 3.0) < 1e-9
    assert got.shape == (64, 3) and on_ground.any()
    np.testing.assert_allclose(np.linalg.norm(ray[~on_ground], axis=1), most, rtol=1e-12)


# ---------------------------------------------------------------- image_math.js


def test_arithmetic_of_images(in_node: Node) -> None:
    rng = np.random.default_rng(5)
    layers = [rng.normal(size=12) + 1j * rng.normal(size=12) for _ in range(3)]
    area = rng.uniform(0.5, 3.0, 4)
    script = """
    const m = await import("sarmitsuba/image_math.js");
    const [a, b] = layers;
    const sum = m.sumOf(layers, 12);
    return { sum, none: m.sumOf([], 3), rcs: m.decibels(sum, 4, null), sigma0: m.decibels(sum, 4, area),
      empty: m.decibels({ re: [0], im: [0] }, 1, null), difference: m.complexDifference(a, b),
      likeness: m.likeness(a, b), same: m.likeness(a, a), quantile: m.quantile([NaN, 3, 1, -Infinity, 2, 4], 0.5),
      nothing: m.quantile([NaN], 0.5), lengths: lengths.map(m.roundLength) };
    """
    lengths = 10.0 ** rng.uniform(-3.0, 5.0, 60)
    given = [{"re": z.real.tolist(), "im": z.imag.tolist()} for z in layers]
    got = in_node(script, layers=given, area=area.tolist(), lengths=[1.0, 2.0, 5.0, *lengths])
    total = sum(layers)
    # tol: float32 of the sums and of decibels
    np.testing.assert_allclose(
        np.array(got["sum"]["re"]) + 1j * np.array(got["sum"]["im"]), total, rtol=0, atol=1e-6
    )
    assert got["none"] == {"re": [0, 0, 0], "im": [0, 0, 0]}
    db = 20.0 * np.log10(np.abs(total))
    np.testing.assert_allclose(got["rcs"], db, rtol=0, atol=1e-4)
    np.testing.assert_allclose(got["sigma0"], db - 10.0 * np.log10(np.tile(area, 3)), rtol=0, atol=1e-4)
    assert got["empty"] == ["-Infinity"]
    a, b = layers[:2]
    np.testing.assert_allclose(
        np.array(got["difference"]["re"]) + 1j * np.array(got["difference"]["im"]), a - b
    )
    assert got["likeness"]["coherence"] == pytest.approx(
        abs(np.vdot(b, a)) / (np.linalg.norm(a) * np.linalg.norm(b))
    )
    assert got["likeness"]["error"] == pytest.approx(
        20.0 * np.log10(np.linalg.norm(a - b) / np.linalg.norm(a))
    )
    assert got["same"]["coherence"] == pytest.approx(1.0) and got["same"]["error"] == "-Infinity"
    assert (got["quantile"], got["nothing"]) == (3, 0)
    assert got["lengths"][:3] == [1, 2, 5]
    for length, round_ in zip(lengths, got["lengths"][3:], strict=True):
        step = 10.0 ** (np.log10(round_) % 1.0)
        assert min(abs(step - s) for s in (1.0, 2.0, 5.0, 10.0)) < 1e-9
        assert round_ <= length < 2.5 * round_ * (1.0 + 1e-9)


# ---------------------------------------------------------------- windows.js, aperture.js, range_profiles.js


def test_windows_are_linear_between_their_nodes(in_node: Node) -> None:
    rng = np.random.default_rng(6)
    nodes, u = rng.uniform(0.0, 1.0, (2, 17)), rng.uniform(-0.6, 0.6, 100)
    script = """
    const { windowNames, windowOf } = await import("sarmitsuba/windows.js");
    const data = { windows: { texts: ["a", "b"], nodes } };
    let words = "";
    try { windowOf(data, "flat"); } catch (error) { words = error.message; }
    return { names: windowNames(data), plain: windowNames({}), b: u.map(windowOf(data, "b")),
      box: u.map(windowOf({}, "rectangular")), words };
    """
    got = in_node(script, nodes=nodes.reshape(-1).tolist(), u=u.tolist())
    assert got["names"] == ["a", "b"] and got["plain"] == ["rectangular"]
    inside = np.abs(u) <= 0.5
    np.testing.assert_allclose(
        got["b"], np.interp(u, np.linspace(-0.5, 0.5, 17), nodes[1]) * inside, atol=1e-12
    )
    np.testing.assert_array_equal(got["box"], inside)
    assert got["words"] == "window flat: not in this page; choose one of a, b"


def test_the_aperture_that_is_left(in_node: Node) -> None:
    rng = np.random.default_rng(7)
    weights = rng.uniform(0.5, 1.0, 40).astype(np.float32)
    script = """
    const { aperturePlan, makeTrackError } = await import("sarmitsuba/aperture.js");
    const data = { nPulses: 40, weights };
    const some = { keepEvery: 2, from: 0.25, to: 0.75 };
    return { whole: aperturePlan(data, {}), part: aperturePlan(data, some),
      band: aperturePlan({ ...data, band: { half: 0.1 } }, some).band,
      errors: ["none", "linear", "quadratic", "sinusoidal"].map((kind) =>
        makeTrackError(5, { kind, amplitude: 2, cycles: 1 })) };
    """
    got = in_node(script, weights=weights.tolist())
    np.testing.assert_array_equal(np.float32(got["whole"]["weights"]), weights)
    used = np.zeros(40, dtype=bool)
    used[np.arange(0, 40, 2)[5:15]] = True
    np.testing.assert_array_equal(np.float32(got["part"]["weights"]), np.where(used, weights, 0))
    assert got["band"] | {"window": None} == pytest.approx(
        {"half": 0.05, "shift": 0.0, "step": 2, "window": None}
    )
    u = np.linspace(-1.0, 1.0, 5)
    np.testing.assert_allclose(
        got["errors"], [0 * u, 2 * u, 2 * u**2, 2 * np.sin(np.pi * u)], rtol=0, atol=1e-12
    )


class Cosine(Pattern):
    """Aperture with a cosine taper: a product of cuts."""

    name, doc, half_power_sine = "cosine", "cosine taper", 0.594482390

    def gain(self, sin_azimuth: Any, sin_elevation: Any, numbers: Any, xp: Any = np) -> Any:
        u, v = (
            self.half_power_sine * s * n for s, n in zip((sin_azimuth, sin_elevation), numbers, strict=True)
        )
        return np.prod(
            [(np.cos(np.pi * w) / (1.0 - np.minimum(4.0 * w * w, 1e9) + 1e-12)) ** 2 for w in (u, v)], axis=0
        )


class Round(Pattern):
    """Lobe that is no product of cuts."""

    name, doc = "round", "round lobe"

    def gain(self, sin_azimuth: Any, sin_elevation: Any, numbers: Any, xp: Any = np) -> Any:
        square = (sin_azimuth * numbers[0]) ** 2 + (sin_elevation * numbers[1]) ** 2
        return np.maximum(1.0 - 0.5 * square, 0.0)


@pytest.mark.parametrize("pattern", ["gaussian", "rectangular", "cosine", "round"])
def test_the_beam_is_ours(pattern: str, in_node: Node, monkeypatch: pytest.MonkeyPatch) -> None:
    for entry in (Cosine(), Round()):
        monkeypatch.setitem(PATTERNS._entries, entry.name, entry)
    rng = np.random.default_rng(8)
    axes, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    antenna = Antenna(pattern=pattern, azimuth_beamwidth=0.2, elevation_beamwidth=0.5)
    ray = axes[0] + 0.3 * rng.normal(size=(50, 3))
    ray = (
        np.vstack([ray, axes[0], -axes[0]])
        / np.linalg.norm(np.vstack([ray, axes[0], -axes[0]]), axis=1)[:, None]
    )
    beam = {
        "pattern": pattern,
        "perWidth": antenna.per_width,
        "boresight": axes[0].tolist(),
        "azimuthAxis": axes[1].tolist(),
        "elevationAxis": axes[2].tolist(),
    }
    if pattern in ("cosine", "round"):
        beam |= {"pattern": "sampled"}
        beam |= {name.partition(".")[2]: array.tolist() for name, array in sample_beam(antenna).items()}
        assert ("gain" in beam) == (pattern == "round")
    script = """
    const { beamGain } = await import("sarmitsuba/aperture.js");
    return rays.map((ray) => beamGain(beam, 0, ...ray));
    """
    got = in_node(script, beam=beam, rays=ray.tolist())
    want = antenna.two_way_amplitude(ray @ axes[1], ray @ axes[2]) * (ray @ axes[0] > 0.0)
    # tol: digits of the half-power point of a sinc; linear between 257 nodes of a plane, whose lobe ends in a kink
    np.testing.assert_allclose(got, want, rtol=0, atol={"cosine": 1e-5, "round": 2e-2}.get(pattern, 1e-7))
    assert got[-2:] == pytest.approx([1, 0], abs=1e-12)


def test_samples_between_bins_are_those_of_the_band(in_node: Node) -> None:
    """A point between two bins, its echo the band's sinc, through four taps of a cubic B-spline."""
    n, fraction, place = 512, 1.0 / 1.2, 250.3
    profile = np.sinc((np.arange(n) - place) * fraction)
    script = """
    const { LEAD, OVERSAMPLING, RangeProfiles } = await import("sarmitsuba/range_profiles.js");
    const made = new RangeProfiles({ nBins: profile.length, bandFraction: fraction,
      profiles: profile.flatMap((value) => [value, 0]) }, "rectangular");
    const out = new Float64Array(2 * made.nStored);
    made.fill(0, out, 0);
    return { LEAD, OVERSAMPLING, last: made.last, out };
    """
    got = in_node(script, profile=profile.tolist(), fraction=fraction)
    samples = np.array(got["out"]).reshape(-1, 2) @ [1.0, 1.0j]
    assert got["last"] == got["OVERSAMPLING"] * (n - 1)
    at = np.random.default_rng(9).uniform(100.0, 400.0, 500)
    i = np.floor(at * got["OVERSAMPLING"]).astype(int)
    u = at * got["OVERSAMPLING"] - i
    taps = np.array([(1 - u) ** 3, 3 * u**3 - 6 * u**2 + 4, -3 * u**3 + 3 * u**2 + 3 * u + 1, u**3]) / 6.0
    value = sum(tap * samples[i + got["LEAD"] - 1 + k] for k, tap in enumerate(taps))
    # tol: the spline's image at the band's edge, -46 dB, and the sinc that the record's ends cut
    assert np.abs(value - np.sinc((at - place) * fraction)).max() < 0.01


# ---------------------------------------------------------------- unpack.js, markup.js, store.js, controls.js


def test_arrays_arrive_as_they_were_packed(in_node: Node) -> None:
    rng = np.random.default_rng(10)
    halves = np.append(rng.normal(size=40), [np.inf, -np.inf, np.nan, 6e-8, 65504.0, 0.0]).astype(np.float16)
    values: dict[str, Any] = {
        name: rng.integers(0, 100, (5, 4)).astype(name)
        for name in ("uint8", "int8", "uint16", "int16", "uint32", "int32")
    }
    values |= {name: rng.normal(size=(3, 7)).astype(name) for name in ("float32", "float64")}
    values |= {
        "halves": halves,
        "flags": rng.random(30) < 0.5,
        "nested": [{"short": np.arange(3)}, "text", None],
    }
    packer = Packer()
    packed = packer.pack(values)
    script = """
    const nodes = new Map(blobs.map((textContent, i) => [`blob${i}`, { textContent, remove() {} }]));
    nodes.set("payload", { textContent: JSON.stringify(packed) });
    globalThis.document = { getElementById: (id) => nodes.get(id) };
    const { readPayload } = await import("sarmitsuba/unpack.js");
    return readPayload();
    """
    got = in_node(script, blobs=packer.blobs, packed=packed)
    assert set(got) == set(values) and got["nested"] == [{"short": [0, 1, 2]}, "text", None]
    for name, value in values.items():
        if name != "nested":
            np.testing.assert_array_equal(
                np.array(got[name], dtype=np.float64), value.astype(np.float64).reshape(-1)
            )


def test_values_of_templates_are_text(in_node: Node) -> None:
    script = """
    const { html } = await import("sarmitsuba/markup.js");
    const { helpText, keyName } = await import("sarmitsuba/controls.js");
    return { one: html`<b title="${text}">${text}</b>`.text, list: html`${[text, html`<i>${1}</i>`, null]}`.text,
      help: helpText([[text, text]], text).text, keys: ["A", "Escape"].map((key) => keyName({ key })) };
    """
    text = """<script>alert("1 & '2'")</script>"""
    got = in_node(script, text=text)
    inside = got["one"].removeprefix('<b title="').removesuffix("</b>")
    attribute, _, content = inside.partition('">')
    assert html.unescape(attribute) == html.unescape(content) == text
    assert not set("<>\"'") & set(attribute + content)
    assert got["list"] == f"{content}<i>1</i>"
    assert "<script" not in got["help"] and got["help"].count(content) == 3
    assert got["keys"] == ["a", "Escape"]


def test_the_ground_is_under_every_footprint_of_the_pass(in_node: Node) -> None:
    rng = np.random.default_rng(13)
    for _ in range(5):
        n, height = 31, float(rng.normal(scale=5.0))
        turn = rng.uniform(0.0, 2.0 * np.pi)
        along = np.array([np.sin(turn), np.cos(turn), 0.0])
        across = np.array([along[1], -along[0], 0.0])
        down = np.array([0.0, 0.0, -1.0])
        look = rng.uniform(0.4, 0.9)
        boresight = np.sin(look) * across + np.cos(look) * down
        axes = [boresight, along, np.cross(boresight, along)]
        track = np.linspace(-300.0, 300.0, n)[:, None] * along - 1e3 * np.tan(look) * across
        track[:, 2] = 1e3 + height
        names = ("boresight", "azimuth_axis", "elevation_axis")
        radar = {name: np.tile(axis, n).tolist() for name, axis in zip(names, axes, strict=True)}
        radar |= {"time": list(range(n)), "position": track.ravel().tolist(), "beam_widths": [0.05, 0.2]}
        grid = {"kind": "ground", "shape": [20, 30], "azimuth": [-10.0, 1.0], "range": [-15.0, 1.0]}
        grid |= {
            "origin": [0.0, 0.0, height],
            "along": along.tolist(),
            "across": across.tolist(),
            "height": height,
        }
        script = """
        const { footprint, passGround, row } = await import("sarmitsuba/localise.js");
        const prints = radar.time.flatMap((_, t) => footprint(row(radar.position, t),
          [radar.boresight, radar.azimuth_axis, radar.elevation_axis].map((axis) => row(axis, t)), radar.beam_widths,
          grid.height, 1e5));
        return { corners: passGround({ radar, grid }, 1), prints, bare: passGround({ radar: null, grid }, 1) };
        """
        got = in_node(script, radar=radar, grid=grid)
        frame = np.stack([along, across], axis=1)
        corners, prints = np.array(got["corners"]) @ frame, np.array(got["prints"]) @ frame
        assert np.ptp(prints[:, 0]) > 600.0  # the pass goes far beyond the image of 20 m
        assert (prints >= corners.min(axis=0)).all() and (prints <= corners.max(axis=0)).all()
        # tol: margins, and footprints of 31 pulses by nine of them
        assert (np.ptp(corners, axis=0) < np.ptp(prints, axis=0) + 60.0).all()
        assert np.allclose(np.array(got["corners"])[:, 2], height)
        np.testing.assert_allclose(np.ptp(np.array(got["bare"]) @ frame, axis=0), [21.0, 31.0], rtol=1e-9)


def test_lit_faces_have_no_shadow_of_their_own_and_others_do(in_node: Node) -> None:
    """Planes of any incidence up to 80 degrees against a shadow map drawn here, each sample and its neighbours."""
    script = """
    const { MAP_SIZE, shadowCamera } = await import("sarmitsuba/lamp.js");
    return { size: MAP_SIZE, ...shadowCamera(2) };
    """
    got = in_node(script)
    texel, depth = 2.0 * got["half"] / got["size"], got["far"] - got["near"]
    rng = np.random.default_rng(14)
    for _ in range(200):
        incidence, turn = rng.uniform(0.0, np.radians(80.0)), rng.uniform(0.0, 2.0 * np.pi)
        slope = np.tan(incidence) * np.array([np.cos(turn), np.sin(turn)])  # depth over the map's axes
        place = rng.uniform(-1.0, 1.0, 2)
        taps = np.stack(np.meshgrid([-1, 0, 1], [-1, 0, 1]), axis=-1).reshape(-1, 2)
        stored = ((np.floor(place / texel) + 0.5 + taps) * texel) @ slope / depth
        own = place @ slope / depth
        assert (own + got["bias"] <= stored + 1e-12).all()
    # what is 2 % of the scene's radius before a face shades it
    assert 0.02 * 2.0 / depth + got["bias"] > 0.0


def test_a_spot_beside_a_bright_line_is_its_side_lobe(in_node: Node) -> None:
    """A line and a point on clutter through the windows' response: side lobes are named, other echoes are not."""
    rng = np.random.default_rng(12)
    rows, columns, spacing = 80, 90, 0.5
    for name, reaches in (("rectangular", -13.0), ("taylor", -33.0)):
        window = parse_window(name)
        u = (np.arange(64) + 0.5) / 64 - 0.5
        weights = window(u) / window(u).sum()

        def response(away: Any, weights: Any = weights, u: Any = u) -> Any:
            return np.cos(2.0 * np.pi * np.multiply.outer(away, u)) @ weights

        cell = window.broadening
        plane = 1e-4 * (rng.normal(size=(rows, columns)) + 1j * rng.normal(size=(rows, columns)))
        along, across = spacing * np.arange(rows), spacing * np.arange(columns)
        line = sum(response(along - place) for place in (18.0, 18.5, 19.0, 20.0))
        plane += np.outer(line, response(across - 20.0))
        own = (20, 62)  # a point of its own 14 dB below the line, far above its side lobes
        plane += 0.5 * np.outer(response(along - 0.5 * own[0]), response(across - 0.5 * own[1]))
        grid = ImageGrid(
            "slant",
            along,
            across + 5e3,
            np.array([0.0, 0.0, 3e3]),
            np.array([0.0, 1.0, 0.0]),
            np.array([1.0, 0.0, 0.0]),
        )
        image = SarImage(
            plane[None].astype(np.complex64), (Layer("VV"),), grid, 0.03, cell, cell, np.full(columns, 0.7)
        )
        lobes = {axis: values.tolist() for axis, values in side_lobes(image, name, name).items()}
        assert lobes["azimuth"][0] == 1.0 and np.all(np.diff(lobes["azimuth"]) <= 0.0)
        # tol: the highest lobe beyond the first zero, -13.3 and -35 dB, at whole pixels of the envelope
        beyond = int(np.ceil((1.6 if name == "rectangular" else 2.4) * 2.0))
        assert 20.0 * np.log10(lobes["range"][beyond]) < reaches + 0.6
        power = np.abs(plane) ** 2
        # local maxima of the line's range side lobes
        line = power[37:40].mean(axis=0)
        beside = [j for j in range(44, 60) if line[j] > line[j - 1] and line[j] > line[j + 1]][:3]
        places = [*[(38, j) for j in beside], own, (38, 40)]
        script = """
        const { spillOf, spillView } = await import("sarmitsuba/spill.js");
        const look = { grid: { shape }, image: { side_lobes: lobes, layers: [{ re, im }] } };
        return places.map((at) => {
          const found = spillOf(look, at, [cell, cell]);
          return found && { ...found, text: spillView(found, 3).text };
        });
        """
        got = in_node(
            script,
            shape=[rows, columns],
            lobes=lobes,
            re=plane.real.ravel().tolist(),
            im=plane.imag.ravel().tolist(),
            places=places,
            cell=2.0 * cell,
        )
        assert len(beside) >= 2 and got[-1] is None and got[-2] is None
        for found in got[: len(beside)]:
            assert abs(found["column"] - 40) <= 1 and 34 <= found["row"] <= 42
            assert "Side lobe of a brighter spot" in found["text"] and found["strongerDb"] > 10.0


def test_a_sweeps_page_has_the_statement_of_its_error(in_node: Node) -> None:
    script = """
    const { statementView } = await import("sarmitsuba/account.js");
    return [statementView({ text, warning: "" }).text, statementView({ text, warning }).text];
    """
    plain, warned = in_node(
        script, text="expected error: sampling <0.1 dB, theory 2 dB", warning="levels are off"
    )
    assert plain == "Expected error: sampling &lt;0.1 dB, theory 2 dB."
    assert warned == plain + " <b>Levels are off.</b>"


def test_listeners_hear_of_changes_once(in_node: Node) -> None:
    script = """
    const { Store } = await import("sarmitsuba/store.js");
    const { turn } = await import("sarmitsuba/controls.js");
    const store = new Store({ a: 1, b: false, c: "x" });
    const heard = [];
    store.on(["a", "b"], (values, changed) => heard.push([{ ...values }, changed]));
    store.set({ a: 1 });
    store.set({ c: "y" });
    store.set({ a: 2, b: true });
    turn(store, "b");
    turn(store, "a", [1, 2, 3]);
    turn(store, "a", [1, 2, 3]);
    return heard;
    """
    assert in_node(script) == [
        [{"a": 2, "b": True, "c": "y"}, ["a", "b"]],
        [{"a": 2, "b": False, "c": "y"}, ["b"]],
        [{"a": 3, "b": False, "c": "y"}, ["a"]],
        [{"a": 1, "b": False, "c": "y"}, ["a"]],
    ]
