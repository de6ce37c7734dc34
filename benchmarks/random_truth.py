"""Random scenes against brute force: automatic settings, references that share no code with the simulator.

``python benchmarks/random_truth.py --count 100 --first 5000`` draws scenes by seed and prints, for each topic, how
many are within 0.5 and 1 dB of the reference in mean level, the errors of peak and coherence, and the ten worst with
the command that repeats each.
"""

import argparse
import json
import math
import sys
import tempfile
import time
import warnings
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import random_reference as reference
import random_scenes as scenes

if TYPE_CHECKING:
    from sarmitsuba import SarImage

# standard error of a mean level that can still tell 0.5 dB, dB
GOOD_ENOUGH_DB = 0.17
# most runs with other speckle that are averaged for a small target
MOST_RUNS = 60


@dataclass(frozen=True)
class Result:
    """One scene.

    Parameters
    ----------
    level_db : simulated over expected energy
    sigma_db : standard error of that, from the number of independent resolution cells; 0 for coherent targets
    peak_db, coherence : of the image against the reference's, NaN for diffuse targets
    said : warnings of the run
    """

    topic: str
    seed: int
    kinds: str
    radar: str
    level_db: float
    sigma_db: float
    peak_db: float
    coherence: float
    expected_dbsm: float
    said: tuple[str, ...]
    seconds: float

    @property
    def command(self) -> str:
        return f"python benchmarks/random_truth.py --topic {self.topic} --first {self.seed} --count 1"


def total_rcs(image: "SarImage") -> float:
    """Sum of |pixel|^2 over the image as a radar cross section (Parseval), m^2."""
    grid = image.grid
    pixel = grid.azimuth_spacing * grid.range_spacing
    cell = image.azimuth_resolution_cell * image.range_resolution_cell
    return float(np.sum(image.rcs()) * pixel / cell)


def run(topic: str, seed: int, folder: Path) -> Result:
    import sarmitsuba

    start = time.perf_counter()
    draw = scenes.DRAWS[topic](seed)
    path = draw.write(folder / f"{topic}_{seed}")
    r = draw.radar
    text = (
        f"{r.band} {r.mode}{'+beam' if r.pattern != 'isotropic' else ''} {r.polarisation} cell {r.range_cell:.2f} x "
        f"{r.azimuth_resolution:.2f} m, look {r.look_angle_deg:.0f}, heading {r.heading_deg:.0f}"
    )
    size = max(float(np.ptp(b.triangles.reshape(-1, 3), axis=0).max()) for b in draw.bodies)
    kinds = "+".join(b.kind for b in draw.bodies) + f" {size:.2f} m"
    peak_db = coherence = math.nan
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        scene = sarmitsuba.load_scene(path)
        if topic == "diffuse":
            expected = reference.diffuse(draw)
            runs = int(
                np.clip(np.ceil((4.343 / GOOD_ENOUGH_DB) ** 2 / max(expected.cells, 1e-9)), 1, MOST_RUNS)
            )
            levels = [
                total_rcs(sarmitsuba.focus(sarmitsuba.simulate(scene, seed=seed + s))) for s in range(runs)
            ]
            level, rcs = float(np.mean(levels)), expected.rcs
            sigma_db = 4.343 / math.sqrt(max(expected.cells, 1e-9) * runs)
        else:
            image = sarmitsuba.focus(sarmitsuba.simulate(scene, seed=seed))
            level, sigma_db = total_rcs(image), 0.0
            rcs, peak_db, coherence = metal(draw, image, size)
    said = tuple(dict.fromkeys(str(w.message) for w in caught))
    level_db = 10.0 * math.log10(max(level, 1e-30) / max(rcs, 1e-30))
    return Result(
        topic,
        seed,
        kinds,
        text,
        level_db,
        sigma_db,
        peak_db,
        coherence,
        10.0 * math.log10(max(rcs, 1e-30)),
        said,
        time.perf_counter() - start,
    )


def metal(draw: scenes.Draw, image: "SarImage", size: float) -> tuple[float, float, float]:
    """Mean RCS over band and aperture; peak (dB) and coherence of the image against the focused reference."""
    r = draw.radar
    n_f = math.ceil(1.5 * (2.0 * size + 8.0 * r.range_cell) / r.range_cell) + 8
    n_p = math.ceil(1.5 * (2.0 * size + 8.0 * r.azimuth_resolution) / r.azimuth_resolution) + 8
    frequency = r.center_frequency + r.bandwidth * ((np.arange(n_f) + 0.5) / n_f - 0.5)
    position = reference.antenna_positions(r, n_p)
    h = reference.physical_optics(draw, position, frequency)
    pixel = image.grid.positions()
    near = (np.abs(pixel[..., :2]) <= size + 3.0 * max(r.range_cell, r.azimuth_resolution)).all(axis=-1)
    weight = reference.aperture_weights(r, position)
    want = reference.focused(h, position, frequency, pixel[near], weight)
    got = image.total()[near]
    peak_db = 20.0 * math.log10(float(np.abs(got).max()) / float(np.abs(want).max()))
    coherence = float(np.abs(np.vdot(want, got)) / np.sqrt(np.vdot(want, want).real * np.vdot(got, got).real))
    level = float(np.average(np.mean(np.abs(h) ** 2, axis=0), weights=weight**2))
    return level, peak_db, coherence


def report(results: list[Result]) -> str:
    lines = []
    for topic in dict.fromkeys(r.topic for r in results):
        good = [r for r in results if r.topic == topic and r.sigma_db <= GOOD_ENOUGH_DB * 1.001]
        if not good:
            continue
        error = np.array([r.level_db for r in good])
        lines.append(
            f"{topic}: {len(good)} of {sum(r.topic == topic for r in results)} scenes tell; mean level within 0.5 dB "
            f"{100 * np.mean(np.abs(error) <= 0.5):.0f} %, 1 dB {100 * np.mean(np.abs(error) <= 1.0):.0f} %, "
            f"3 dB {100 * np.mean(np.abs(error) <= 3.0):.0f} %; median {np.median(error):+.2f} dB"
        )
        edges = np.array([-99.0, -3.0, -1.0, -0.5, -0.2, 0.2, 0.5, 1.0, 3.0, 99.0])
        count = np.histogram(error, edges)[0]
        lines += [
            f"  {a:+6.1f} ... {b:+6.1f} dB {n:4d} {'#' * n}"
            for a, b, n in zip(edges[:-1], edges[1:], count, strict=True)
        ]
        for r in sorted(good, key=lambda r: -abs(r.level_db))[:10]:
            extra = (
                "" if math.isnan(r.peak_db) else f", peak {r.peak_db:+.2f} dB, coherence {r.coherence:.4f}"
            )
            lines.append(
                f"  {r.level_db:+7.2f} dB (+-{r.sigma_db:.2f}){extra}: {r.kinds}; {r.radar}; "
                f"{'warned' if r.said else 'silent'}; {r.command}"
            )
    return "\n".join(lines)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--topic", choices=tuple(scenes.DRAWS), action="append")
    parser.add_argument("--first", type=int, default=0, help="first seed")
    parser.add_argument("--count", type=int, default=20, help="scenes per topic")
    parser.add_argument("--json", type=Path, help="write every result there")
    args = parser.parse_args()
    results = []
    with tempfile.TemporaryDirectory() as folder:
        for topic in args.topic or tuple(scenes.DRAWS):
            for seed in range(args.first, args.first + args.count):
                result = run(topic, seed, Path(folder))
                results.append(result)
                print(
                    f"{topic} {seed}: {result.level_db:+.2f} dB +-{result.sigma_db:.2f}, peak {result.peak_db:+.2f}, "
                    f"coherence {result.coherence:.4f}, {result.seconds:.1f} s; {result.kinds}; {result.radar}"
                    + "".join(f"\n    said: {text}" for text in result.said),
                    flush=True,
                )
    print(report(results))
    if args.json:
        args.json.write_text(json.dumps([asdict(r) for r in results], indent=1), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
