"""A measured pattern: reading it, what is measured of it, and every place that uses a pattern."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from sarmitsuba.core.arrays import F64
from sarmitsuba.core.errors import RadarError
from sarmitsuba.files import read_raw, write_raw
from sarmitsuba.loading.build import SceneMesh, build_scene
from sarmitsuba.machine.backend import arrays, device_numbers, dr
from sarmitsuba.radar.antenna import Antenna
from sarmitsuba.radar.description import RadarDescription
from sarmitsuba.radar.film import FilmDescription
from sarmitsuba.radar.pattern import PATTERNS, Pattern, PatternTable
from sarmitsuba.scene.geometry import PointTarget
from sarmitsuba.scene.scene import Scene
from sarmitsuba.scene.settings import TraceSettings
from sarmitsuba.simulation.execution.render import simulate
from tests.support.unweighted import focus

WIDTHS = (2.0, 6.0)  # degrees
SHAPES = ("gaussian", "rectangular")
POINT = PointTarget("point", np.zeros(3), 1.0)


def write_table(
    path: Path, gain: Callable[[float, F64], F64], reach: float = 8.0, per_width: int = 100
) -> Path:
    """A CSV of both cuts; ``gain`` takes the number of the cut and angles in rad."""
    lines = ["cut, angle_deg, gain_db  # made by a test"]
    for number, (name, width) in enumerate(zip(("azimuth", "elevation"), WIDTHS, strict=True)):
        angle = np.arange(-reach * per_width, reach * per_width + 1) * (width / per_width)
        db = 10.0 * np.log10(np.maximum(gain(number, np.radians(angle)), 1e-12))
        lines += [f"{name}, {a:.8g}, {g:.8g}" for a, g in zip(angle, db, strict=True)]
    path.write_text("\n".join(lines), encoding="utf-8")
    return path


def analytic(shape: str) -> Antenna:
    return Antenna(shape, 1.0, *np.radians(WIDTHS))


def sampled(path: Path, shape: str, **how: int) -> Path:
    """The table that samples a pattern known in closed form."""
    antenna = analytic(shape)

    def cut(number: int, angle: F64) -> F64:
        sine, zero = np.sin(angle), np.zeros(angle.size)
        return np.asarray(antenna.two_way_amplitude(*((sine, zero) if number == 0 else (zero, sine))))

    return write_table(path, cut, **how)


@pytest.mark.parametrize("shape", SHAPES)
def test_a_table_of_a_known_pattern_is_that_pattern(shape: str, tmp_path: Path) -> None:
    table = PatternTable.from_csv(sampled(tmp_path / "beam.csv", shape))
    known = analytic(shape)
    measured = Antenna("table", 1.0, *(cut.beamwidth for cut in table.cuts), table)
    assert np.degrees([measured.azimuth_beamwidth, measured.elevation_beamwidth]) == pytest.approx(
        WIDTHS, rel=1e-4
    )  # tol: cubic between samples of a hundredth of the width
    assert measured.nulls == pytest.approx(known.nulls, rel=0.01)  # tol: the null is a sample
    assert measured.azimuth_bends == pytest.approx(known.azimuth_bends, rel=0.35)  # tol: the sinc's own bends
    rng = np.random.default_rng(3)
    azimuth, elevation = rng.uniform(-0.2, 0.2, 4000), rng.uniform(-0.4, 0.4, 4000)
    want = known.two_way_amplitude(azimuth, elevation)
    got = measured.two_way_amplitude(azimuth, elevation)
    # tol: cubic at a hundredth of the width, and linear steps of -99 dB; PCHIP is quadratic next to a null
    assert np.abs(got - want).max() < 1e-4
    # in a kernel
    types = arrays()
    numbers = device_numbers(types.Float32, measured.numbers)
    lanes = [types.Float32(np.asarray(a, dtype=np.float32)) for a in (azimuth, elevation)]
    compiled = np.asarray(measured.normalise(*lanes, numbers, dr))
    assert np.abs(compiled - got).max() < 2e-5  # tol: linear steps of -99 dB; float32


def test_between_and_beyond(tmp_path: Path) -> None:
    # Rationale: a lopsided lobe with the peak off boresight and a floor; gains count from the cut's own peak.
    path = tmp_path / "beam.csv"
    path.write_text(
        "azimuth,-4,20\nazimuth,-2,33.0103\nazimuth,0,39\nazimuth,1,40\nazimuth,3,30\n"
        "elevation,-10,-30\nelevation,0,0\nelevation,10,-30\n",
        encoding="utf-8",
    )
    azimuth, elevation = PatternTable.from_csv(path).cuts
    at = np.sin(np.radians([-80.0, -4.0, 1.0, 3.0, 60.0]))
    antenna = Antenna("table", 1.0, azimuth.beamwidth, elevation.beamwidth, PatternTable.from_csv(path))
    got = antenna.two_way_amplitude(at, np.zeros(5))
    assert 10.0 * np.log10(got) == pytest.approx([-20.0, -20.0, 0.0, -10.0, -10.0], abs=1e-4)
    assert np.degrees(azimuth.half_power[0]) < -0.5 < 1.0 < np.degrees(azimuth.half_power[1]) < 3.0
    assert azimuth.null is None  # falls to its ends
    fine = antenna.two_way_amplitude(np.sin(np.radians(np.linspace(-4, 3, 999))), np.zeros(999))
    assert fine.min() >= 0.01 * (1 - 1e-5) and fine.max() <= 1.0 + 1e-12  # tol: rounded dB


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("azimuth,1\n", "every line needs cut, angle_deg, gain_db"),
        ("pitch,0,0\n", "the cut azimuth or elevation"),
        ("azimuth,-1,-5\nazimuth,0,0\nazimuth,1,-5\n", "the cut in elevation has 0 angles"),
        ("azimuth,-1,-5\nazimuth,1,0\nazimuth,0,-5\n", "does not rise strictly"),
        (
            "azimuth,-1,-1\nazimuth,0,0\nazimuth,1,-5\n",
            "does not fall to half power on both sides: -1 dB at -1 deg",
        ),
        ("azimuth,1,-9\nazimuth,2,0\nazimuth,3,-9\n", "leaves out the boresight"),
        ("azimuth,-1,nan\nazimuth,0,0\nazimuth,1,-5\n", "finite"),
    ],
)
def test_bad_tables_are_one_clear_line(text: str, said: str, tmp_path: Path) -> None:
    path = tmp_path / "beam.csv"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(RadarError, match="beam") as caught:
        PatternTable.from_csv(path)
    assert said in str(caught.value) and "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("values", "said"),
    [
        ({"pattern": "table"}, "needs a pattern_file"),
        ({"pattern_file": "x.csv"}, "pattern_file has no effect with pattern = isotropic"),
        ({"pattern": "table", "pattern_file": "none.csv"}, "cannot read the antenna pattern"),
        (
            {"pattern": "table", "pattern_file": "x.csv", "azimuth_beamwidth_deg": 1.0},
            "azimuth_beamwidth_deg = 1 has no effect with pattern = table; the table has its own widths",
        ),
    ],
)
def test_a_table_stands_alone(values: dict[str, object], said: str) -> None:
    with pytest.raises(RadarError) as caught:
        build_scene(points=[PointTarget("p", np.zeros(3), 1.0)], radar=RadarDescription(**values))  # type: ignore[arg-type]
    assert said in str(caught.value)


SOIL = {
    "material": "medium_dry_ground",
    "rms_height": 0.05,
    "diffuse_law": "constant",
    "diffuse_level_db": -10.0,
}


def scene(mode: str, beam: dict[str, object]) -> Scene:
    """A step of two faces on rough ground with two points, half of it out of the main lobe."""
    corners = np.array([[-14.0, -20.0, 0.0], [14.0, -20.0, 0.0], [14.0, 20.0, 0.0], [-14.0, 20.0, 0.0]])
    wall = np.array([[6.0, -5.0, 0.0], [6.0, 5.0, 0.0], [6.0, 5.0, 4.0], [6.0, -5.0, 4.0]])
    faces = np.array([[0, 1, 2], [0, 2, 3]])
    radar = RadarDescription(
        mode=mode, slant_range=600.0, bandwidth=100e6, prf=330.0, azimuth_resolution=1.5, speed=80.0, **beam
    )  # type: ignore[arg-type]
    return build_scene(
        [SceneMesh(corners, faces, SOIL, "ground"), SceneMesh(wall, faces, "pec", "wall")],
        points=[
            PointTarget("a", np.array([-3.0, 4.0, 1.0]), 50.0),
            PointTarget("b", np.array([2.0, -12.0, 3.0]), 50.0),
        ],
        radar=replace(radar, aim_x=0.0, aim_y=0.0, aim_z=0.0),
        film=FilmDescription(image_extent_azimuth=36.0, image_extent_range=24.0),
        settings=TraceSettings(max_depth=2),
    )


@pytest.mark.slow
@pytest.mark.filterwarnings(
    "ignore:focus:sarmitsuba.core.errors.SarmitsubaWarning"
)  # rows at the rim, wanted here
@pytest.mark.parametrize(("mode", "shape"), [("stripmap", "gaussian"), ("spotlight", "rectangular")])
def test_a_table_serves_wherever_a_pattern_does(mode: str, shape: str, tmp_path: Path) -> None:
    # Rationale: kernel, points, blocks of pulses, coverage, band and backprojection's weights in one image.
    file = sampled(tmp_path / "beam.csv", shape)
    widths = {"azimuth_beamwidth_deg": WIDTHS[0], "elevation_beamwidth_deg": WIDTHS[1]}
    known = scene(mode, {"pattern": shape, **widths})
    table = scene(mode, {"pattern": "table", "pattern_file": str(file)})
    assert table.radar.track.n_pulses == pytest.approx(known.radar.track.n_pulses, abs=4)
    # the null is a sample of the table: the same aperture and track, so that pixels can be compared
    table = replace(
        table,
        radar=replace(known.radar, antenna=table.radar.antenna),
    )
    raws = [simulate(one, seed=1) for one in (known, table)]
    images = [focus(raw) for raw in raws]
    pixels = [image.total() for image in images]
    error = 20.0 * np.log10(np.linalg.norm(pixels[1] - pixels[0]) / np.linalg.norm(pixels[0]))
    assert error < -60.0, error  # tol: interpolation of the table; rims of the beam divided by their gain
    other = "omega_k" if mode == "stripmap" else "factorised,error=-40"
    first, second = (focus(raw, focuser=other).total() for raw in raws)
    assert np.linalg.norm(second - first) < 2e-3 * np.linalg.norm(first)  # tol: as above
    # and through a file
    write_raw(raws[1], tmp_path / "raw.h5")
    again = read_raw(tmp_path / "raw.h5")
    assert again.radar.antenna.pattern == "table" and again.radar.antenna.table is not None
    np.testing.assert_array_equal(focus(again).data, images[1].data)


def test_another_table_compiles_nothing(tmp_path: Path) -> None:
    def beam(name: str, shape: str, per_width: int) -> dict[str, object]:
        file = sampled(tmp_path / name, shape, per_width=per_width, reach=4)
        return {"pattern": "table", "pattern_file": str(file)}

    first = scene("stripmap", beam("a.csv", "gaussian", 20))
    other = scene("stripmap", beam("b.csv", "rectangular", 47))
    before = dr.flag(dr.JitFlag.KernelHistory)
    dr.set_flag(dr.JitFlag.KernelHistory, True)
    try:
        for one in (first, other):
            dr.kernel_history_clear()
            focus(simulate(one, seed=1))
            missed = [k for k in dr.kernel_history() if k["type"] == dr.KernelType.JIT and not k["cache_hit"]]
    finally:
        dr.set_flag(dr.JitFlag.KernelHistory, before)
    assert not missed


def test_patterns_are_listed_for_users() -> None:
    assert {"isotropic", "gaussian", "rectangular", "table"} <= set(PATTERNS.names)


class Tapered(Pattern):
    """Cut of an aperture with a cosine taper, the same in both axes."""

    name, doc = "tapered_by_a_test", "cosine taper"
    half_power_sine = 0.594482390  # cos(pi u) / (1 - 4 u^2) = 1 / sqrt(2)

    def gain(self, sin_azimuth: Any, sin_elevation: Any, numbers: Any, xp: Any = np) -> Any:
        u, v = (
            self.half_power_sine * s * n for s, n in zip((sin_azimuth, sin_elevation), numbers, strict=True)
        )
        cuts = [(np.cos(np.pi * w) / (1.0 - 4.0 * w * w + 1e-12)) ** 2 for w in (u, v)]
        return cuts[0] * cuts[1]


class Shapeless(Pattern):
    """Pattern that belongs to no aperture."""

    name, doc = "shapeless_by_a_test", "no aperture"

    def gain(self, sin_azimuth: Any, sin_elevation: Any, numbers: Any, xp: Any = np) -> Any:
        return 1.0 / (1.0 + (sin_azimuth * numbers[0]) ** 2 + (sin_elevation * numbers[1]) ** 2)


def test_a_pattern_states_its_widths_null_and_bends(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a cosine taper: half power at 0.594, null at 1.5 wavelengths over the length."""
    for entry in (Tapered(), Shapeless()):
        monkeypatch.setitem(PATTERNS._entries, entry.name, entry)
    wavelength = 299792458.0 / 9.6e9
    given = {
        "pattern": "tapered_by_a_test",
        "center_frequency": 9.6e9,
        "antenna_length": 2.0,
        "antenna_height": 1.0,
    }
    scene = build_scene([], points=[POINT], radar=RadarDescription(**given))
    antenna = scene.radar.antenna
    assert np.degrees(antenna.azimuth_beamwidth) == pytest.approx(1.0637, abs=1e-3)
    assert antenna.two_way_amplitude(np.sin(0.5 * antenna.azimuth_beamwidth), 0.0) == pytest.approx(
        0.5, abs=1e-5
    )
    # tol: the null lies on one of 500 samples a half-width
    assert antenna.nulls == pytest.approx((1.5 * wavelength / 2.0, 1.5 * wavelength), rel=2e-3)
    slope, bend = antenna.azimuth_bends
    assert 0.6 < slope < 0.9 and 1.0 < bend < 1.7
    for name in SHAPES:  # measured as others are, the built-in ones are what they state
        pattern = PATTERNS[name]
        # tol: the rectangle states the Gaussian of its widths
        assert Pattern.find_bends(pattern) == pytest.approx(pattern.find_bends(), rel=0.08)
    assert Pattern.find_null(PATTERNS["rectangular"]) == pytest.approx(
        PATTERNS["rectangular"].find_null(), rel=1e-3
    )
    assert Pattern.find_null(PATTERNS["gaussian"]) is None
    with pytest.raises(RadarError, match="belongs to no aperture; give azimuth_beamwidth_deg"):
        build_scene([], points=[POINT], radar=RadarDescription(**given | {"pattern": "shapeless_by_a_test"}))
