"""Derivatives by every parameter in drawn scenes of every mode, method, antenna, channel and content.

Each cell is the derivative by one kind of parameter, along a drawn direction of its values, against central differences
of sixth order of whole runs. Its verdict:

right    off by at most 3e-3 of the norm of the differences
turns    rays hit or echo differently at the values of the differences, which then tell nothing: a ray at an edge
refuses  one line says why there is no derivative
wrong    else: a failure

Modes, methods and patterns are those that are registered, and the contents those below: a new one is in the table by
itself. Shapes are moved where nothing stands behind them; what they hide and show is compared by ``moving_edges.py``.

Usage: python -m benchmarks.studies.derivative_combinations [--first SEED] [--count DRAWS] [--content NAME] [--page]
"""

import argparse
import re
import sys
import tempfile
import warnings
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import trimesh

from benchmarks.support import harness
from benchmarks.support.drawn_beams import gaussian_table
from sarmitsuba import (
    FilmDescription,
    Material,
    Motion,
    PointTarget,
    RadarDescription,
    Scene,
    SceneMesh,
    TraceSettings,
    build_scene,
)
from sarmitsuba.apps.fit.forward_model import ForwardModel
from sarmitsuba.apps.fit.parsing import parse
from sarmitsuba.core.errors import SarmitsubaError
from sarmitsuba.loading.build import SceneVolume
from sarmitsuba.radar.mode import MODES
from sarmitsuba.radar.pattern import PATTERNS
from sarmitsuba.scene.materials.material import SurfaceMaps
from sarmitsuba.scene.materials.texture import Bitmap, place_in_plan
from sarmitsuba.scene.motion import STILL
from sarmitsuba.scene.settings import METHODS
from sarmitsuba.tracing.scatterers.wires.kind import WireTarget
from tests.support.differences import box, compared_all, house

RIGHT, TURNS, REFUSES, WRONG = "right", "turns", "refuses", "wrong"
COLOURS = {RIGHT: "🟩", TURNS: "⬜", REFUSES: "🟦", WRONG: "🟥"}
# relative error up to which a derivative is right: float32 amplitudes over the steps of the differences
TOLERANCE = 3e-3
CHANNELS = ("VV", "HH", "VV,HV", "HH,HV,VH,VV", "RH,RV")
OF_RADAR = ("gain", "clock_offset", "track:2", "pointing")
OF_SHAPE = ("shift", "height:box", "scale:box", "rotation:box")
HALF = 25.0
# of the rays, m: fewer than by itself, as derivatives are those of the paths that are found
SPACING = {"hybrid": 0.15, "raw": 0.4}
# pulses: every one is traced by method raw
PULSES = {"hybrid": 8, "raw": 3}
DRAWS = 30
# kinds of parameters of a drawn scene besides the radar's: kernels that carry more take long to compile
AT_ONCE = 2

HEAD = """# Derivatives: combinations

Derivatives by every kind of [parameter](../gradients.md) in drawn scenes of every radar mode, method, antenna
pattern, channel and content, against central differences of whole runs. Drawn are, for each: mode, method, pattern
or two antennas, channels, heading, side, look angle, squint, range, band (L, C, X), and the sizes, places and materials
of what there is to see.

| | |
|---|---|
| {right} right | off by at most 3e-3 of the norm of differences of sixth order |
| {turns} turns | rays at edges hit or echo differently at the values of the differences, which then tell nothing |
| {refuses} refuses | no derivative, and one line that says why |
| {wrong} wrong | else: a failure |

```sh
python -m benchmarks.studies.derivative_combinations --page                 # this page
python -m benchmarks.studies.derivative_combinations --first 3 --count 1    # one draw
```

Shapes are moved where nothing stands behind them: what moving shapes hide and show is compared with means over many
lattices of rays ([derivatives](../gradients.md)).
"""


@dataclass(frozen=True)
class Content:
    """What there is to see.

    Parameters
    ----------
    box : material of the box named ``box``
    ground : material of the ground
    parameters : kinds besides the radar's
    depth : bounces
    effects : switched
    roof : whether the box is a house
    motion : of the box
    wires, points, volumes : beside it
    """

    box: Material
    ground: Material
    parameters: tuple[str, ...]
    depth: int = 1
    effects: tuple[tuple[str, str], ...] = ()
    roof: bool = False
    motion: Motion = STILL
    wires: tuple[WireTarget, ...] = ()
    points: tuple[PointTarget, ...] = ()
    volumes: tuple[SceneVolume, ...] = ()


def rough(rng: np.random.Generator, name: str) -> Material:
    """A material of a drawn law with all its properties."""
    law = str(rng.choice(["small_perturbation", "small_slope"]))
    return Material(
        name,
        permittivity=complex(rng.uniform(3.0, 9.0), -rng.uniform(0.1, 2.0)),
        rms_height=float(rng.uniform(0.001, 0.003)),
        diffuse_law=law,
        correlation_length=float(rng.uniform(0.02, 0.06)),
        cross_polar_ratio_db=-10.0,
    )


def levelled(rng: np.random.Generator, name: str) -> Material:
    """A material with a diffuse level."""
    return Material(
        name,
        permittivity=complex(rng.uniform(3.0, 9.0), -rng.uniform(0.1, 2.0)),
        rms_height=float(rng.uniform(0.001, 0.003)),
        diffuse_law=str(rng.choice(["lambert", "constant_gamma"])),
        diffuse_level_db=float(rng.uniform(-20.0, -5.0)),
        cross_polar_ratio_db=-10.0,
    )


def silent(rng: np.random.Generator) -> Material:
    """Ground that returns nothing to the radar."""
    return Material("soil", permittivity=complex(rng.uniform(3.0, 9.0), -rng.uniform(0.1, 2.0)))


OF_WALL = tuple(f"{kind}:wall" for kind in ("permittivity", "loss", "rms_height", "correlation_length"))
OF_SOIL = ("level:soil", "permittivity:soil", "loss:soil", "rms_height:soil")


def mirrors(rng: np.random.Generator) -> Content:
    return Content(rough(rng, "wall"), levelled(rng, "soil"), OF_WALL + OF_SOIL, 3)


def alone(rng: np.random.Generator) -> Content:
    return Content(rough(rng, "wall"), silent(rng), OF_SHAPE + OF_WALL, roof=bool(rng.integers(2)))


def metal(rng: np.random.Generator) -> Content:
    soil = replace(silent(rng), rms_height=float(rng.uniform(0.001, 0.003)))
    return Content(Material("wall", pec=True), soil, ("permittivity:soil", "loss:soil", "rms_height:soil"), 3)


def edges(rng: np.random.Generator) -> Content:
    return Content(
        Material("wall", pec=True), silent(rng), OF_SHAPE[:1], effects=(("edge_diffraction", "on"),)
    )


def wires(rng: np.random.Generator) -> Content:
    ends = [rng.uniform([6.0, -9.0, 0.5], [9.0, 9.0, 4.0], (2, 3)) for _ in range(4)]
    own = tuple(WireTarget(f"wire{i}", start, end, 0.02) for i, (start, end) in enumerate(ends))
    return Content(rough(rng, "wall"), silent(rng), ("permittivity:wall", *OF_SHAPE), wires=own)


def points(rng: np.random.Generator) -> Content:
    places = rng.uniform([6.0, -9.0, 0.5], [9.0, 9.0, 4.0], (4, 3))
    own = tuple(PointTarget(f"point{i}", place, 100.0) for i, place in enumerate(places))
    return Content(rough(rng, "wall"), silent(rng), ("permittivity:wall", *OF_SHAPE), points=own)


def crowns(rng: np.random.Generator) -> Content:
    crown = trimesh.creation.icosphere(2, 2.0).apply_translation([*rng.uniform([6.0, -6.0], [9.0, 6.0]), 4.0])
    season = str(rng.choice(["deciduous_summer", "conifer"]))
    own = (SceneVolume(crown.vertices, crown.faces, season, "crown"),)
    return Content(rough(rng, "wall"), silent(rng), ("permittivity:wall", *OF_SHAPE), volumes=own)


def pane(rng: np.random.Generator) -> Content:
    glass = Material(
        "wall",
        permittivity=complex(rng.uniform(3.0, 8.0), -0.05),
        thickness=float(rng.uniform(0.004, 0.02)),
        rms_height=1e-4,
    )
    through = str(rng.choice(["on", "off"]))
    kinds = ("thickness:wall", "permittivity:wall", "loss:wall", "level:soil")
    return Content(glass, levelled(rng, "soil"), kinds, 3, effects=(("transmission", through),))


def pairs(rng: np.random.Generator) -> Content:
    kinds = ("level:soil", "permittivity:wall", "shift")
    return Content(rough(rng, "wall"), levelled(rng, "soil"), kinds, 2, effects=(("diffuse_pairs", "on"),))


def moving(rng: np.random.Generator) -> Content:
    return Content(
        rough(rng, "wall"),
        silent(rng),
        ("permittivity:wall", "shift"),
        motion=Motion(velocity=(1.0, 2.0, 0.0)),
    )


def water(rng: np.random.Generator) -> Content:
    sea = Material(
        "soil",
        permittivity=70.0 - 40.0j,
        diffuse_law="sea",
        law_parameters=(("wind_speed", float(rng.uniform(3.0, 8.0))),),
    )
    return Content(rough(rng, "wall"), sea, ("permittivity:wall", "permittivity:soil"))


def mapped(rng: np.random.Generator) -> Content:
    level = Bitmap(
        10.0 ** (0.1 * rng.normal(0.0, 3.0, (2, 3))), place_in_plan((-HALF, -HALF, HALF, HALF)), smooth=True
    )
    soil = replace(levelled(rng, "soil"), maps=SurfaceMaps(level=level))
    return Content(rough(rng, "wall"), soil, ("level:soil", "level_map:soil", "permittivity:wall"), 3)


CONTENTS: dict[str, Callable[[np.random.Generator], Content]] = {
    f.__name__: f
    for f in (alone, mirrors, metal, edges, wires, points, crowns, pane, pairs, moving, water, mapped)
}


@dataclass(frozen=True)
class Cell:
    """Derivative by one kind of parameter in one drawn scene; ``said``: the refusal."""

    axes: dict[str, str]
    parameter: str
    verdict: str
    error: float
    said: str
    command: str


def draw(seed: int, content: str, folder: Path) -> tuple[Scene, tuple[str, ...], dict[str, str]]:
    """Scene of a seed, kinds of parameters of its content, and its classes; ``folder`` for a file of its beam."""
    rng = np.random.default_rng([seed, *content.encode()])
    what = CONTENTS[content](rng)
    # bursts have no derivatives
    modes = [mode.name for mode in MODES if not mode.bursts]
    mode, pattern = str(rng.choice(modes)), str(rng.choice(PATTERNS.names))
    # methods without raw data, which are refused, now and then
    method = str(rng.choice(METHODS if rng.random() < 0.15 else ["hybrid", "raw"]))
    two = pattern == "isotropic" and bool(rng.integers(3) == 0)
    carrier = float(rng.choice([1.3e9, 5.4e9, 9.65e9]))
    slant_range = float(rng.uniform(1500.0, 6000.0))
    law = MODES[mode]
    radar = RadarDescription(
        mode=mode,
        slant_range=slant_range,
        look_angle_deg=float(rng.uniform(25.0, 55.0)),
        heading_deg=float(rng.uniform(0.0, 360.0)),
        look_side=str(rng.choice(["left", "right"])),  # type: ignore[arg-type]
        center_frequency=carrier,
        bandwidth=150e6,
        n_pulses=PULSES.get(method, 8),
        noise_temperature=0.0,
        polarisation=str(rng.choice(CHANNELS)),
    )
    if law.squints:
        radar = replace(radar, squint_angle_deg=float(rng.uniform(-15.0, 15.0)))
    if pattern != "isotropic":
        width = np.degrees(rng.uniform(0.6, 1.5, 2) * 22.0 / slant_range)
        widths: dict[str, Any] = {
            "azimuth_beamwidth_deg": float(width[0]),
            "elevation_beamwidth_deg": float(width[1]),
        }
        if pattern == "table":
            radar = replace(radar, pattern_file=str(gaussian_table(folder / "beam.csv", widths)))
        radar = replace(radar, pattern=pattern, **widths)
    if two:
        radar = replace(radar, receiver_offset_along=float(rng.uniform(5.0, 50.0)))
    flat = HALF * np.array([[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [1.0, 1.0, 0.0], [-1.0, 1.0, 0.0]])
    body = (house if what.roof else box)(rng, float(rng.uniform(0.0, np.pi)))
    effects = {"diffuse_pairs": "off", "edge_diffraction": "off"} | dict(what.effects)
    scene = build_scene(
        [
            SceneMesh(*body, what.box, "box", motion=what.motion),
            SceneMesh(flat, np.array([[0, 1, 2], [0, 2, 3]]), what.ground, "ground"),
        ],
        points=what.points,
        wires=what.wires,
        volumes=what.volumes,
        radar=radar,
        film=FilmDescription(image_extent_azimuth=22.0, image_extent_range=22.0),
        settings=TraceSettings(
            method=method,  # type: ignore[arg-type]
            key_pulse_interval=1 if law.all_round else 8,
            gridding_width=8,
            max_depth=what.depth,
            effects=effects,  # type: ignore[arg-type]
            ray_spacing=SPACING.get(method, 0.0),
        ),
        name=f"{content}{seed}",
    )
    shift = f"shift:box:{'xyz'[rng.integers(3)]}"
    own = rng.permutation(what.parameters)[:AT_ONCE]
    kinds = tuple(shift if kind == "shift" else str(kind) for kind in (*OF_RADAR, *own))
    band = {1.3e9: "L", 5.4e9: "C", 9.65e9: "X"}[carrier]
    beam = "two antennas" if two else pattern
    axes = {
        "content": content,
        "mode": mode,
        "method": method,
        "beam": beam,
        "channels": radar.polarisation,
        "band": band,
    }
    return scene, kinds, axes


def cells_of(seed: int, content: str) -> list[Cell]:
    """All cells of a drawn scene."""
    command = f"--content {content} --first {seed} --count 1"
    with warnings.catch_warnings(), tempfile.TemporaryDirectory() as folder:
        warnings.simplefilter("ignore")
        scene, kinds, axes = draw(seed, content, Path(folder))
        cells, accepted = [], []
        for kind in kinds:
            try:
                ForwardModel(scene, parse(kind, scene))
            except SarmitsubaError as refusal:
                cells.append(Cell(axes, kind, REFUSES, np.nan, str(refusal), command))
            else:
                accepted.append(kind)
        found = compared_all(scene, accepted, seed) if accepted else []
    for kind, one in zip(accepted, found, strict=True):
        verdict = RIGHT if one.error <= TOLERANCE else WRONG if one.steady else TURNS
        cells.append(Cell(axes, kind, verdict, one.error, "", command))
    return cells


def of_kind(parameter: str) -> str:
    """Kind of a parameter, with the target where it matters."""
    return re.sub(r":[xyz]$|:2$", "", parameter)


def page(cells: Sequence[Cell]) -> str:
    """The page, Markdown."""
    counts = Counter(cell.verdict for cell in cells)
    total = ", ".join(f"{COLOURS[name]} {counts[name]} {name}" for name in COLOURS)
    draws = len({cell.command for cell in cells})
    lines = [HEAD.format(**COLOURS), f"{draws} draws, {len(cells)} cells: {total}.\n"]
    for axis in ("content", "mode", "method", "beam", "channels", "band"):
        lines.append(_table(axis, cells))
    lines += ["## Errors of what is right\n", "| parameter | cells | median | largest |", "|---|---|---|---|"]
    for kind in sorted({of_kind(cell.parameter) for cell in cells}):
        errors = [c.error for c in cells if of_kind(c.parameter) == kind and c.verdict == RIGHT]
        if errors:
            lines.append(f"| `{kind}` | {len(errors)} | {np.median(errors):.1e} | {max(errors):.1e} |")
    lines += ["\n## Why derivatives are refused\n", "| cells | |", "|---|---|"]
    said = Counter(re.sub(r"^\w+?\d+: ", "", cell.said) for cell in cells if cell.verdict == REFUSES)
    lines += [f"| {n} | {text.replace('|', '/')} |" for text, n in said.most_common()]
    return "\n".join(lines) + "\n"


def _table(axis: str, cells: Sequence[Cell]) -> str:
    """Verdicts by parameter and the classes of one axis."""
    names = sorted({cell.axes[axis] for cell in cells})
    count = Counter((of_kind(cell.parameter), cell.axes[axis], cell.verdict) for cell in cells)
    lines = [f"## By {axis}\n", "| parameter | " + " | ".join(names) + " |", "|---" * (len(names) + 1) + "|"]
    for kind in dict.fromkeys(of_kind(cell.parameter) for cell in cells):
        texts = []
        for name in names:
            found = {v: count[kind, name, v] for v in COLOURS if count[kind, name, v]}
            texts.append(" ".join(f"{COLOURS[v]} {n}" for v, n in found.items()))
        lines.append(f"| `{kind}` | " + " | ".join(texts) + " |")
    return "\n".join(lines) + "\n"


def main() -> int:
    """Print the cells; 1 where one is wrong."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--first", type=int, default=0, help="first seed")
    parser.add_argument(
        "--count", type=int, default=DRAWS, help="drawn scenes; each content takes the next in turn"
    )
    parser.add_argument("--content", choices=list(CONTENTS), help="this one alone")
    parser.add_argument("--page", action="store_true", help="make a page in docs/generated")
    args = parser.parse_args()
    cells: list[Cell] = []
    for seed in range(args.first, args.first + args.count):
        content = args.content or list(CONTENTS)[seed % len(CONTENTS)]
        own = cells_of(seed, content)
        cells += own
        print(f"{seed:4d} " + " ".join(own[0].axes.values()))
        for cell in own:
            text = cell.said if cell.verdict == REFUSES else f"{cell.error:.1e}"
            print(f"     {COLOURS[cell.verdict]} {cell.parameter:24} {text}", flush=True)
    counts = Counter(cell.verdict for cell in cells)
    print(", ".join(f"{counts[name]} {name}" for name in COLOURS))
    if args.page:
        harness.write_page(harness.PAGES / "derivative_combinations.md", page(cells))
    return int(counts[WRONG] > 0)


if __name__ == "__main__":
    sys.exit(main())
