"""Every mode with every focuser and method, at drawn squints, places, grids, windows, beams and channels.

Each cell is an ideal point against the exact sum of its echoes (combinations_reference.py). Its verdict:

right    level within 0.05 dB, place within 0.05 cells, phase within 1 deg, in every channel
warns    not right, and a warning said that something is amiss
refuses  one line says why there is no image
wrong    not right, and nothing was said: a failure

Modes, focusers, methods and patterns are those that are registered: a new one is in the table by itself.

Usage: python -m benchmarks.studies.combinations [--first SEED] [--count DRAWS] [--mode MODE] [--page]
"""

import argparse
import json
import sys
import tempfile
import warnings
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property, partial
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from benchmarks.support import harness
from benchmarks.support.combinations_page import (
    COLOURS,
    COUNT,
    FROM_ECHOES,
    REFUSES,
    RIGHT,
    WARNS,
    WRONG,
    Cell,
    columns,
    page,
)
from benchmarks.support.combinations_reference import (
    SPEED_OF_LIGHT,
    WINDOWS,
    Deviation,
    Numbers,
    deviation,
    exact_image,
)
from benchmarks.support.drawn_beams import gaussian_table
from sarmitsuba.core.arrays import C128, F64
from sarmitsuba.core.errors import SarmitsubaError, SarmitsubaWarning
from sarmitsuba.loading.build import build_scene
from sarmitsuba.radar.description import RadarDescription
from sarmitsuba.radar.film import FilmDescription
from sarmitsuba.radar.mode import MODES
from sarmitsuba.radar.pattern import PATTERNS
from sarmitsuba.radar.polarisation import COMPACT
from sarmitsuba.radar.radar import Radar
from sarmitsuba.scene.geometry import PointTarget
from sarmitsuba.scene.scene import Scene
from sarmitsuba.scene.settings import METHODS
from sarmitsuba.signal.focusing import focus
from sarmitsuba.signal.image import ImageGrid, SarImage
from sarmitsuba.signal.raw_data import RawData
from sarmitsuba.simulation.execution.render import render, simulate

T = TypeVar("T")

BANDS = {"P": 0.435e9, "L": 1.27e9, "C": 5.4e9, "X": 9.65e9, "Ku": 16.0e9}
SQUINTS = ("none", "to 10 deg", "to 30 deg")
PLACES = ("aim point", "off along", "off across", "off both")
# most pulses times image cells off the aim point: longer tracks show nothing else
MOST_CELLS = 250.0
# half the side of the chip about a point, cells; and the step of the slopes
CHIP, STEP = 1.6, 0.03
# of a channel in which an ideal point has no echo: rounding
NOTHING = 1e-5


@dataclass(frozen=True, eq=False)
class Draw:
    """A radar, its image, and a point in it.

    Parameters
    ----------
    mode, seed : what drew it
    axes : its classes, by which the tables are laid out
    sensor, film : parameters by name
    point : position in the file's frame, m
    amplitude : root of its RCS, with its phase
    cells : nominal, on the image's grid in azimuth and range, m
    windows : over range and azimuth
    method : of ``FROM_ECHOES``, for the focusers
    """

    mode: str
    seed: int
    axes: dict[str, str]
    sensor: dict[str, Any]
    film: dict[str, Any]
    point: F64
    amplitude: complex
    cells: tuple[float, float]
    windows: tuple[str, str]
    method: str

    @property
    def command(self) -> str:
        """What prints this draw's cells."""
        return f"python -m benchmarks.studies.combinations --mode {self.mode} --first {self.seed} --count 1"

    def scene(self) -> Scene:
        """The scene of the program."""
        sensor = dict(self.sensor)
        own = {p.name for mode in MODES for p in mode.parameters}
        more = {name: sensor.pop(name) for name in list(sensor) if name in own}
        rcs, phase = abs(self.amplitude) ** 2, float(np.angle(self.amplitude))
        with tempfile.TemporaryDirectory() as folder:
            if sensor.get("pattern") == "table":
                sensor["pattern_file"] = str(gaussian_table(Path(folder) / "beam.csv", sensor))
            return build_scene(
                points=[PointTarget("point", self.point, rcs, phase)],
                radar=RadarDescription(mode=self.mode, mode_parameters=more, **sensor),
                film=FilmDescription(**self.film),
            )


def draw(mode: str, seed: int) -> Draw:
    """The draw of a seed: nothing in it is chosen but the bounds."""
    law = MODES[mode]
    rng = np.random.default_rng([seed, *mode.encode()])
    squint_class = str(rng.choice(SQUINTS)) if law.squints else "none"
    low, high = {"none": (0.0, 0.0), "to 10 deg": (0.3, 10.0), "to 30 deg": (10.0, 30.0)}[squint_class]
    squint = float(rng.uniform(low, high) * rng.choice([-1.0, 1.0]))
    look = float(rng.uniform(max(25.0, abs(squint) + 8.0), 62.0))
    band = str(rng.choice(list(BANDS)))
    wavelength = SPEED_OF_LIGHT / BANDS[band]
    cell = float(max(rng.uniform(0.4, 2.0), 1.5 * wavelength))
    range_cell = float(max(rng.uniform(0.4, 1.5), 2.0 * wavelength))
    # as far as so many pulses of an aperture take it
    n_pulses = np.exp(rng.uniform(np.log(30.0), np.log(800.0)))
    slant_range = float(np.clip(1.6 * n_pulses * cell**2 / wavelength, 1.5e3, 60e3))
    heading = float(rng.uniform(-180.0, 180.0))
    side = str(rng.choice(["left", "right"]))
    sensor: dict[str, Any] = {
        "center_frequency": BANDS[band],
        "bandwidth": SPEED_OF_LIGHT / (2.0 * range_cell),
        "slant_range": slant_range,
        "look_angle_deg": look,
        "heading_deg": heading,
        "look_side": side,
        "speed": float(rng.uniform(60.0, 200.0)),
        "aim_x": float(rng.uniform(-5.0, 5.0)),
        "aim_y": float(rng.uniform(-5.0, 5.0)),
        "aim_z": 0.0,
    }
    if squint:
        sensor["squint_angle_deg"] = squint
    for parameter in law.parameters:
        if parameter.kind == "float" and np.isfinite(parameter.maximum):
            low = max(parameter.minimum, 0.1 * parameter.maximum)
            sensor[parameter.name] = float(rng.uniform(low, parameter.maximum))
    circles = law.all_round
    if circles:
        cell = range_cell = 2.0 * wavelength
        sensor |= {"slant_range": min(slant_range, 2e3), "bandwidth": SPEED_OF_LIGHT / (2.0 * range_cell)}
    else:
        sensor["azimuth_resolution"] = cell

    # place of the image off the aim point, along and across
    place = str(rng.choice(PLACES))
    along_off = float(rng.uniform(0.15, 1.0) * rng.choice([-1.0, 1.0])) * (
        "along" in place or "both" in place
    )
    across_off = float(rng.uniform(0.15, 1.0) * rng.choice([-1.0, 1.0])) * (
        "across" in place or "both" in place
    )
    reach = min(20.0 if circles else MOST_CELLS, 0.04 * sensor["slant_range"] / cell)
    off = np.array([along_off, across_off]) * reach * cell

    beam = str(rng.choice([name for name in PATTERNS.names]))
    receiver = beam == "isotropic" and bool(rng.integers(3) == 0)
    if beam != "isotropic":
        # wide enough for the aperture, and in modes that hold the beam for the way to the image too
        width = 2.0 * np.degrees(wavelength / (4.0 * cell)) * rng.uniform(0.9, 1.5)
        if not law.own_apertures:
            width = np.degrees(2.2 * (abs(off[0]) + 20.0 * cell) / sensor["slant_range"]) + 0.1
        lit = np.degrees(2.0 * (abs(off[1]) + 30.0 * range_cell) / sensor["slant_range"])
        sensor |= {
            "pattern": beam,
            "azimuth_beamwidth_deg": float(min(width, 60.0)),
            "elevation_beamwidth_deg": float(min(max(lit, 1.0) * rng.uniform(1.0, 3.0), 60.0)),
        }
    if receiver:
        shift = rng.uniform(-1.0, 1.0, 3) * [0.02, 0.02, 0.005] * sensor["slant_range"]
        sensor |= {
            f"receiver_offset_{axis}": float(v)
            for axis, v in zip(("along", "across", "up"), shift, strict=True)
        }

    turn = np.radians(heading)
    along = np.array([np.sin(turn), np.cos(turn), 0.0])
    across = np.array([along[1], -along[0], 0.0]) * (1.0 if side == "right" else -1.0)
    center = np.array([sensor["aim_x"], sensor["aim_y"], 0.0]) + off[0] * along + off[1] * across
    # all round, the response is a part of the range cell wide, and pixels are as fine
    share = 0.3 if circles else 1.0
    cells = (share * cell, share * range_cell / np.sin(np.radians(look)))
    extent = rng.uniform(14.0, 30.0, 2) * cells
    grid = "ground" if circles else str(rng.choice(["slant", "ground"]))
    film = {
        "image_grid": grid,
        "image_center_x": float(center[0]),
        "image_center_y": float(center[1]),
        "image_height": 0.0,
        "image_extent_azimuth": float(extent[0]),
        "image_extent_range": float(extent[1]),
    }
    place_in = rng.uniform(-0.3, 0.3, 2) * extent
    height = 0.0 if circles or rng.integers(3) else float(rng.uniform(-1.0, 1.0) * range_cell)
    point = center + place_in[0] * along + place_in[1] * across + [0.0, 0.0, height]
    channels = str(rng.choice(["VV", "HH", "VV,HV", "HH,HV,VH,VV", "RH,RV", str(rng.choice(COMPACT))]))
    sensor["polarisation"] = channels
    windows = (str(rng.choice(list(WINDOWS))), str(rng.choice(list(WINDOWS))))
    return Draw(
        mode=mode,
        seed=seed,
        axes={
            "mode": mode,
            "squint": squint_class,
            "place": place,
            "grid": grid,
            "range window": windows[0],
            "azimuth window": windows[1],
            "beam": "two antennas" if receiver else beam,
            "channels": channels,
            "band": band,
        },
        sensor=sensor,
        film=film,
        point=point,
        amplitude=complex(np.sqrt(rng.uniform(0.5, 20.0)) * np.exp(2j * np.pi * rng.uniform())),
        cells=(cells[0], range_cell if grid == "slant" else cells[1]),
        windows=windows,
        method=str(rng.choice(FROM_ECHOES)),
    )


@dataclass(frozen=True, eq=False)
class Chip:
    """The exact image about a point.

    Parameters
    ----------
    pick : its pixels in an image
    exact : (m,) complex128
    moved : the same of places moved by ``+-STEP`` cells in azimuth, then in range
    """

    pick: tuple[NDArray[np.intp], ...]
    exact: C128
    moved: list[C128]


@dataclass(frozen=True, eq=False)
class Truth:
    """The exact image of a draw.

    Parameters
    ----------
    draw : of the radar and the point
    scene : of the program; its radar's numbers and the point's place are read
    """

    draw: Draw
    scene: Scene
    _chips: list[Chip] = field(default_factory=list)

    @cached_property
    def numbers(self) -> Numbers:
        """Of the radar."""
        radar: Radar = self.scene.radar
        kind = radar.antenna.pattern
        return Numbers(
            sent=radar.track.position,
            received=radar.tracks[-1].position,
            time=radar.track.time,
            velocity=radar.track.velocity,
            boresight=radar.pointing.boresight,
            along=radar.pointing.azimuth_axis,
            up=radar.pointing.elevation_axis,
            frequency=self.draw.sensor["center_frequency"],
            bandwidth=self.draw.sensor["bandwidth"],
            pattern="gaussian" if kind == "table" else kind,
            beamwidths=tuple(
                np.radians(self.draw.sensor.get(f"{cut}_beamwidth_deg", 180.0))
                for cut in ("azimuth", "elevation")
            ),
            half_aperture=radar.half_aperture,
        )

    def places(self, grid: ImageGrid, azimuth: F64, rng: F64) -> F64:
        """Scene positions of grid coordinates (m,) each, (m, 3) m."""
        across = rng
        if grid.kind == "slant":
            across = np.sqrt(rng**2 - (grid.origin[2] - grid.height) ** 2)
        flat = np.array([grid.origin[0], grid.origin[1], grid.height])
        return flat + azimuth[:, None] * grid.along + across[:, None] * grid.across

    def coordinates(self, grid: ImageGrid) -> tuple[float, float]:
        """Where the point stands on a grid, m: on its plane at the same distance from the line of flight."""
        point, antenna = self.scene.points[0].position, self.numbers.sent[len(self.numbers.sent) // 2]
        distance = np.hypot((point - antenna) @ grid.across, point[2] - antenna[2])
        azimuth = float((point - grid.origin) @ grid.along)
        if grid.kind == "slant":
            return azimuth, float(distance)
        across = np.sqrt(distance**2 - (antenna[2] - grid.height) ** 2)
        return azimuth, float(across - (grid.origin - antenna) @ grid.across)

    def image(self, places: F64) -> C128:
        """Exact pixels there, for a co-polar channel."""
        point = np.broadcast_to(self.scene.points[0].position, self.numbers.sent.shape)
        return exact_image(self.numbers, places, [(point, self.draw.amplitude)], *self.draw.windows)

    def chip(self, grid: ImageGrid) -> Chip:
        """The exact image about the point; all images of a draw have one grid."""
        if self._chips:
            return self._chips[0]
        here = self.coordinates(grid)
        near = [
            np.flatnonzero(np.abs(axis - middle) <= CHIP * cell)
            for axis, middle, cell in zip((grid.azimuth, grid.range), here, self.draw.cells, strict=True)
        ]
        azimuth, rng = (
            axis.ravel() for axis in np.meshgrid(grid.azimuth[near[0]], grid.range[near[1]], indexing="ij")
        )
        steps = [(0.0, 0.0), (STEP, 0.0), (-STEP, 0.0), (0.0, STEP), (0.0, -STEP)]
        wide, deep = self.draw.cells
        places = [self.places(grid, azimuth + a * wide, rng + b * deep) for a, b in steps]
        exact, *moved = np.split(self.image(np.concatenate(places)), len(steps))
        self._chips.append(Chip(np.ix_(*near), exact, moved))
        return self._chips[0]

    def compare(self, image: SarImage) -> tuple[Deviation, float]:
        """The worst channel's deviation, and the level of a channel that shows nothing over the point's."""
        chip = self.chip(image.grid)
        found, leak = [], 0.0
        for channel in image.channels:
            factor = response(channel)
            pixels = image.total(channel).astype(np.complex128)[chip.pick].ravel()
            if factor == 0.0:
                leak = max(leak, float(np.abs(pixels).max() / np.abs(chip.exact).max()))
            else:
                found.append(
                    deviation(pixels, factor * chip.exact, [factor * one for one in chip.moved], STEP)
                )
        return max(found, key=Deviation.badness, default=Deviation(0.0, 0.0, 0.0, 0.0)), leak


def response(channel: str) -> complex:
    """Part of a scatterer with HH = VV = 1 and HV = 0 in a channel: RH = (HH + j VH) / sqrt(2), ..."""
    sent, received = channel
    if sent in "HV":
        return complex(sent == received)
    return {"R": 1j, "L": -1j, "D": 1.0}[sent] ** (received == "V") / np.sqrt(2.0)


def cells_of(draw: Draw, only: Sequence[str] = ()) -> Iterator[Cell]:
    """All cells of a draw, or those of some columns."""
    wanted = [c for c in columns() if not only or c in only]

    def echoes() -> tuple[Scene, RawData]:
        scene = draw.scene()
        return scene, simulate(replace(scene, settings=replace(scene.settings, method=draw.method)))

    made, before = attempt(echoes)
    if made is None:
        for column in wanted:
            yield Cell(draw.axes, column, REFUSES, None, before, draw.command)
        return
    scene, raw = made
    truth = Truth(draw, scene)
    windows = {"range_window": draw.windows[0], "azimuth_window": draw.windows[1]}
    for column in wanted:
        if column in METHODS:
            image, said = attempt(partial(render, scene, method=column, **windows))
        else:
            image, said = attempt(partial(focus, raw, request=scene.image, focuser=column, **windows))
        if image is None:
            yield Cell(draw.axes, column, REFUSES, None, said, draw.command)
            continue
        found, leak = truth.compare(image)
        right = found.badness() <= 1.0 and leak <= NOTHING
        verdict = RIGHT if right else WARNS if before or said else WRONG
        yield Cell(draw.axes, column, verdict, found, (*before, *said), draw.command)


def attempt(work: Callable[[], T]) -> tuple[T | None, tuple[str, ...]]:
    """What the work gives, and its warnings; None and the one line of a refusal."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        try:
            done = work()
        except SarmitsubaError as error:
            return None, (str(error),)
    return done, tuple(str(w.message) for w in caught if issubclass(w.category, SarmitsubaWarning))


def read(path: Path) -> Iterator[Cell]:
    """Cells of a file that an earlier run wrote."""
    for line in path.read_text(encoding="utf-8").splitlines():
        facts = json.loads(line)
        found = facts.pop("deviation")
        yield Cell(**facts | {"said": tuple(facts["said"])}, deviation=Deviation(**found) if found else None)


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--mode", choices=MODES.names, action="append")
    parser.add_argument("--column", choices=columns(), action="append", help="of the matrix")
    parser.add_argument("--first", type=int, default=0, help="first seed")
    parser.add_argument("--count", type=int, default=COUNT, help="draws per mode")
    parser.add_argument("--lines", type=Path, help="append every cell there, and go on where it ends")
    parser.add_argument("--page", action="store_true", help="make a page in docs/generated")
    args = parser.parse_args()
    known: dict[str, list[Cell]] = {}
    for cell in read(args.lines) if args.lines and args.lines.exists() else ():
        known.setdefault(cell.command, []).append(cell)
    found: list[Cell] = []
    for seed in range(args.first, args.first + args.count):
        for mode in args.mode or MODES.names:
            drawn = draw(mode, seed)
            cells = known.get(drawn.command, [])
            if not cells:
                for cell in cells_of(drawn, args.column or ()):
                    cells.append(cell)
                    print(cell.text(), flush=True)
                    for text in cell.said if args.count == 1 else ():
                        print(f"        {text}")
                if args.lines:
                    with args.lines.open("a", encoding="utf-8") as file:
                        file.writelines(json.dumps(asdict(cell)) + "\n" for cell in cells)
            found += cells
    counts = Counter(cell.verdict for cell in found)
    print(f"{len(found)} cells: " + ", ".join(f"{counts[name]} {name}" for name in COLOURS))
    if args.page:
        harness.write_page(harness.PAGES / "combinations.md", page(found))
    return int(counts[WRONG] > 0)


if __name__ == "__main__":
    sys.exit(main())
