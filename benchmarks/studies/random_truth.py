"""Random scenes against brute force: automatic settings, references that share no code with what they check.

``python -m benchmarks.studies.random_truth --count 100 --first 5000`` draws scenes by seed and prints, for each
topic, how many are within 0.5 and 1 dB of the reference in mean level, how many are off by more than 3 dB without a
warning, the errors of peak, position and coherence, and the ten worst with the command that repeats each.

``--lines FILE`` appends every scene to a file as soon as it is done and leaves out those that it holds already, so
that a long run (``--jobs 2 --count 300``) can be cut off and go on; ``--summary FILE ...`` prints the table of files.

Topics with automatic settings, which ``all`` counts: ``diffuse`` against the energy of the lit area, ``metal`` against
physical optics, ``fine`` (several bodies: shadows, mirrors) against the program's own dense raw run. Stress topics,
with a table of their own: ``metal_coarse`` and ``fine_coarse``, the same with rays forced 1 to 8 wavelengths apart.
"""

import argparse
import json
import math
import multiprocessing
import sys
import tempfile
import time
import warnings
from collections.abc import Iterable, Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from benchmarks.support import random_reference as reference
from benchmarks.support import random_scenes as scenes
from sarmitsuba.core.arrays import C128
from tests.support.unweighted import focus

if TYPE_CHECKING:
    from sarmitsuba import SarImage

# standard error of a mean level that can still tell 0.5 dB, dB
GOOD_ENOUGH_DB = 0.17
# most runs with other speckle that are averaged
MOST_RUNS = 12
# around the reference's peak the simulated one is looked for, resolution cells
PEAK_REACH = 1.5
# rays per wavelength of the reference of ``fine``
DENSE = 4.5
# an error that wants a warning which names its cause, dB
WARN_FROM_DB = 3.0


@dataclass(frozen=True)
class Result:
    """One scene.

    Parameters
    ----------
    level_db : simulated over expected energy
    sigma_db : standard error of that, from the number of independent resolution cells; 0 for coherent targets
    peak_db, position, coherence : of the image against the reference's, the peaks' distance in resolution cells; NaN
        for diffuse targets
    expected_dbsm : mean radar cross section of the reference
    said : warnings of the run
    seconds : CPU time, s
    failed : error that the run ended with
    """

    topic: str
    seed: int
    kinds: str
    radar: str
    level_db: float = math.nan
    sigma_db: float = 0.0
    peak_db: float = math.nan
    position: float = math.nan
    coherence: float = math.nan
    expected_dbsm: float = math.nan
    said: tuple[str, ...] = ()
    seconds: float = 0.0
    failed: str = ""

    @property
    def command(self) -> str:
        return f"python -m benchmarks.studies.random_truth --topic {self.topic} --first {self.seed} --count 1"

    @property
    def tells(self) -> bool:
        """Whether the reference is good enough to tell."""
        return not self.failed and self.sigma_db <= GOOD_ENOUGH_DB * 1.001

    @property
    def unwarned(self) -> bool:
        """Far off without a word."""
        return self.tells and abs(self.level_db) > WARN_FROM_DB and not self.said

    def text(self) -> str:
        """One line, without what the run said."""
        head = f"{self.topic} {self.seed}: "
        if self.failed:
            return head + f"failed: {self.failed}; {self.kinds}; {self.radar}"
        image = ""
        if not math.isnan(self.peak_db):
            image = f", peak {self.peak_db:+.2f} dB, {self.position:.2f} cells off, coherence {self.coherence:.4f}"
        return head + (
            f"{self.level_db:+.2f} dB +-{self.sigma_db:.2f}{image}; {'warned' if self.said else 'silent'}; "
            f"{self.seconds:.1f} CPU s; {self.kinds}; {self.radar}"
        )


class Measured(NamedTuple):
    """What a topic's comparison yields, see :class:`Result`; the first two are in m^2."""

    simulated: float
    expected: float
    sigma_db: float = 0.0
    peak_db: float = math.nan
    position: float = math.nan
    coherence: float = math.nan


def total_rcs(image: "SarImage") -> float:
    """Sum of |pixel|^2 over the image as a radar cross section (Parseval), m^2."""
    grid = image.grid
    pixel = grid.azimuth_spacing * grid.range_spacing
    cell = image.azimuth_resolution_cell * image.range_resolution_cell
    return float(np.sum(image.rcs()) * pixel / cell)


def run(topic: str, seed: int, folder: Path) -> Result:
    """Draw a scene, simulate it and compare."""
    start = time.process_time()
    draw = scenes.DRAWS[topic](seed)
    r = draw.radar
    radar = (
        f"{r.band} {r.mode}{'+beam' if r.pattern != 'isotropic' else ''} {r.polarisation} cell {r.range_cell:.2f} x "
        f"{r.azimuth_resolution:.2f} m, look {r.look_angle_deg:.0f}, heading {r.heading_deg:.0f}"
    )
    if draw.ray_spacing:
        radar += f", rays {draw.ray_spacing / r.wavelength:.1f} wavelengths apart"
    kinds = "+".join(b.kind for b in draw.bodies) + f" {draw.size:.2f} m"
    failed, found = "", None
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        try:
            compared = {"diffuse": diffuse, "fine": fine, "fine_coarse": fine}.get(topic, metal)
            found = compared(draw, folder / f"{topic}_{seed}")
        except Exception as error:  # a long run goes on, and counts it
            failed = f"{type(error).__name__}: {str(error).splitlines()[0] if str(error) else ''}"
    said = tuple(dict.fromkeys(str(w.message) for w in caught))
    result = Result(topic, seed, kinds, radar, said=said, seconds=time.process_time() - start, failed=failed)
    if found is None:
        return result
    return replace(
        result,
        level_db=10.0 * math.log10(max(found.simulated, 1e-30) / max(found.expected, 1e-30)),
        sigma_db=found.sigma_db,
        peak_db=found.peak_db,
        position=found.position,
        coherence=found.coherence,
        expected_dbsm=10.0 * math.log10(max(found.expected, 1e-30)),
    )


def diffuse(draw: scenes.Draw, folder: Path) -> Measured:
    """Energy of the lit area; the mean of as many copies and runs with other speckle as the reference needs to tell."""
    import sarmitsuba

    expected = reference.diffuse(draw)
    cells = max(expected.cells, 1e-9)
    wanted = max(1, math.ceil((4.343 / GOOD_ENOUGH_DB) ** 2 / cells))
    many, copies = scenes.side_by_side(draw, wanted)
    runs = min(math.ceil(wanted / copies), MOST_RUNS)
    scene = sarmitsuba.load_scene(many.write(folder))
    levels = [total_rcs(focus(sarmitsuba.simulate(scene, seed=draw.seed + s))) for s in range(runs)]
    return Measured(float(np.mean(levels)), copies * expected.rcs, 4.343 / math.sqrt(cells * runs * copies))


def metal(draw: scenes.Draw, folder: Path) -> Measured:
    """Physical optics over band and aperture, and the image focused from it."""
    import sarmitsuba

    r, size = draw.radar, draw.size
    scene = sarmitsuba.load_scene(draw.write(folder))
    image = focus(sarmitsuba.simulate(scene, seed=draw.seed))
    n_f = math.ceil(1.5 * (2.0 * size + 8.0 * r.range_cell) / r.range_cell) + 8
    n_p = math.ceil(1.5 * (2.0 * size + 8.0 * r.azimuth_resolution) / r.azimuth_resolution) + 8
    frequency = r.center_frequency + r.bandwidth * ((np.arange(n_f) + 0.5) / n_f - 0.5)
    position = reference.antenna_positions(r, n_p)
    h = reference.physical_optics(draw, position, frequency)
    near = _near(draw, image)
    weight = reference.aperture_weights(r, position)
    want = np.zeros(near.shape, dtype=np.complex128)
    want[near] = reference.focused(h, position, frequency, image.grid.positions()[near], weight)
    level = float(np.average(np.mean(np.abs(h) ** 2, axis=0), weights=weight**2))
    return Measured(
        total_rcs(image), level, 0.0, *_compared(draw, image, np.where(near, image.total(), 0.0), want)
    )


def fine(draw: scenes.Draw, folder: Path) -> Measured:
    """The dense run with every pulse traced; same speckle."""
    import sarmitsuba

    image = focus(
        sarmitsuba.simulate(sarmitsuba.load_scene(draw.write(folder / "automatic")), seed=draw.seed)
    )
    dense = replace(draw, ray_spacing=draw.radar.wavelength / DENSE, method="raw")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # what the reference says is not what the user's run says
        best = focus(
            sarmitsuba.simulate(sarmitsuba.load_scene(dense.write(folder / "dense")), seed=draw.seed)
        )
    return Measured(
        total_rcs(image), total_rcs(best), 0.0, *_compared(draw, image, image.total(), best.total())
    )


def _near(draw: scenes.Draw, image: "SarImage") -> NDArray[np.bool_]:
    """Pixels about the target."""
    reach = draw.size + 3.0 * max(draw.radar.range_cell, draw.radar.azimuth_resolution)
    return np.asarray((np.abs(image.grid.positions()[..., :2]) <= reach).all(axis=-1))


def _compared(draw: scenes.Draw, image: "SarImage", got: C128, want: C128) -> tuple[float, float, float]:
    """Peak (dB), its place (resolution cells) and coherence of an image against the reference's, (n_a, n_r) each."""
    norm = np.sqrt(np.vdot(want, want).real * np.vdot(got, got).real)
    if norm == 0.0:
        return -math.inf, math.nan, 0.0
    grid = image.grid
    a, b = np.unravel_index(int(np.abs(want).argmax()), want.shape)
    step = np.array(
        [
            grid.azimuth_spacing / draw.radar.azimuth_resolution,
            grid.range_spacing / draw.radar.range_cell,
        ]
    )
    reach = np.ceil(PEAK_REACH / step).astype(int)
    low = np.maximum(np.array([a, b]) - reach, 0)
    around = np.abs(got[low[0] : a + reach[0] + 1, low[1] : b + reach[1] + 1])
    place = np.array(np.unravel_index(int(around.argmax()), around.shape)) + low
    return (
        20.0 * math.log10(float(np.abs(got).max()) / float(np.abs(want).max())),
        float(np.linalg.norm((place - [a, b]) * step)),
        float(np.abs(np.vdot(want, got)) / norm),
    )


# ---------------------------------------------------------------- many scenes


def _run_in(job: tuple[str, int]) -> Result:
    with tempfile.TemporaryDirectory() as folder:
        return run(*job, Path(folder))


def results_of(jobs: list[tuple[str, int]], workers: int) -> Iterator[Result]:
    """Results as they come."""
    if workers == 1:
        yield from map(_run_in, jobs)
        return
    # fork would copy the state of the just-in-time compiler; a worker that lives on keeps its kernels
    with ProcessPoolExecutor(workers, mp_context=multiprocessing.get_context("spawn")) as pool:
        for done in as_completed([pool.submit(_run_in, job) for job in jobs]):
            yield done.result()


def read(files: Iterable[Path]) -> list[Result]:
    """Results of files of JSON lines; of a scene that several hold, the last."""
    found = {}
    for file in files:
        for line in file.read_text(encoding="utf-8").splitlines():
            try:
                row = json.loads(line)
            except json.JSONDecodeError:
                continue  # the line that a run was writing when it was cut off
            found[row["topic"], row["seed"]] = Result(**{**row, "said": tuple(row["said"])})
    return list(found.values())


def report(results: list[Result]) -> str:
    """Table of the topics with automatic settings, and one of the stress topics."""
    automatic = [r for r in results if r.topic not in scenes.STRESS]
    stress = [r for r in results if r.topic in scenes.STRESS]
    tables = [_table(automatic, "all (automatic settings)"), _table(stress, "all (rays forced far apart)")]
    return "\n\n".join(table for table in tables if table)


def _table(results: list[Result], name: str) -> str:
    """Shares, histogram and the worst of each topic, and the shares of all of them."""
    lines = []
    topics = dict.fromkeys(r.topic for r in results)
    for topic in topics:
        mine = [r for r in results if r.topic == topic]
        good = [r for r in mine if r.tells]
        lines.append(_shares(topic, mine))
        if not good:
            continue
        edges = np.array([-99.0, -3.0, -1.0, -0.5, -0.2, 0.2, 0.5, 1.0, 3.0, 99.0])
        count = np.histogram(np.clip([r.level_db for r in good], -99.0, 99.0), edges)[0]
        width = max(1, math.ceil(count.max() / 80))
        lines += [
            f"  {a:+6.1f} ... {b:+6.1f} dB {n:4d} {'#' * (n // width)}"
            for a, b, n in zip(edges[:-1], edges[1:], count, strict=True)
        ]
        coherence = np.array([r.coherence for r in good if not math.isnan(r.coherence)])
        if coherence.size:
            peak = np.abs([r.peak_db for r in good if not math.isnan(r.coherence)])
            place = np.array([r.position for r in good if not math.isnan(r.position)])
            lines.append(
                f"  peak within 0.5 dB {100 * np.mean(peak <= 0.5):.1f} %, within a third of a cell "
                f"{100 * np.mean(place <= 1 / 3):.1f} %; coherence above 0.99 {100 * np.mean(coherence > 0.99):.1f} %, "
                f"least {coherence.min():.3f}"
            )
        worst = sorted(good, key=lambda r: -abs(r.level_db))[:10]
        lines += [f"  {r.text()}; {r.command}" for r in [*(r for r in mine if r.failed), *worst]]
    if len(topics) > 1:
        lines.append(_shares(name, results))
    return "\n".join(lines)


def _shares(name: str, results: list[Result]) -> str:
    good = [r for r in results if r.tells]
    failed = sum(bool(r.failed) for r in results)
    text = f"{name}: {len(good)} of {len(results)} scenes tell" + (f", {failed} failed" if failed else "")
    if good:
        error = np.abs([r.level_db for r in good])
        text += (
            f"; mean level within 0.5 dB {100 * np.mean(error <= 0.5):.1f} %, "
            f"1 dB {100 * np.mean(error <= 1.0):.1f} %; "
            f"off by more than 3 dB {np.sum(error > WARN_FROM_DB)}, {sum(r.unwarned for r in good)} of them without a "
            f"warning; median {np.median([r.level_db for r in good]):+.2f} dB"
        )
    return text + f"; {np.mean([r.seconds for r in results]):.1f} CPU s per scene"


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--topic", choices=tuple(scenes.DRAWS), action="append")
    parser.add_argument("--first", type=int, default=0, help="first seed")
    parser.add_argument("--count", type=int, default=20, help="scenes per topic")
    parser.add_argument("--jobs", type=int, default=1, help="processes")
    parser.add_argument("--lines", type=Path, help="append every result there, and go on where it ends")
    parser.add_argument("--summary", type=Path, nargs="+", help="only print the table of such files")
    args = parser.parse_args()
    if args.summary:
        print(report(read(args.summary)))
        return 0
    topics = args.topic or tuple(scenes.DRAWS)
    jobs = [(topic, seed) for seed in range(args.first, args.first + args.count) for topic in topics]
    results = [
        r
        for r in read([args.lines] if args.lines and args.lines.exists() else [])
        if (r.topic, r.seed) in jobs
    ]
    known = {(r.topic, r.seed) for r in results}
    for result in results_of([job for job in jobs if job not in known], args.jobs):
        results.append(result)
        print(result.text() + "".join(f"\n    said: {text}" for text in result.said), flush=True)
        if args.lines:
            with args.lines.open("a", encoding="utf-8") as file:
                file.write(json.dumps(asdict(result)) + "\n")
    print(report(sorted(results, key=lambda r: (topics.index(r.topic), r.seed))))
    return 0


if __name__ == "__main__":
    sys.exit(main())
