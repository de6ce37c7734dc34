"""Where physical optics ends: three metal scenes on ground against the boundary-element method, over angle.

``python -m benchmarks.suite.full_wave`` compares the simulator with the stored reference; ``--reference FILE`` with
another one. ``--compute FILE`` solves the scenes again with bempp-cl (``pip install .[full-wave]``) and writes such a
file.
"""

import argparse
import json
import re
import sys
import time
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.support import full_wave_solver as solver
from benchmarks.support import harness
from sarmitsuba.core.arrays import C128, F64
from sarmitsuba.truth.validation import full_wave as scenes

# right triangles whose legs are that share of a wavelength: 192 unknowns per square wavelength at an eighth, 147 at a
# seventh; the first scene is solved on a coarser mesh too, which shows what the mesh leaves
LEGS = {"corner": (8, 6), "box": (7,), "cylinder": (7,)}
METHOD = "electric field integral equation, dense matrix, single precision; mirror images for the ground"
# the resistive sheets inside closed bodies, wavelengths from the metal
INSET = 0.5


def body(name: str, step: float) -> solver.Body:
    """The part of a scene's body that its mirrors complete, in triangles of ``step``."""
    if name == "corner":
        plate = solver.rectangle([0, 0, 0], [scenes.CORNER_WIDTH, 0, 0], [0, 0, scenes.CORNER_HEIGHT], step)
        return solver.Body((plate,), (solver.SWAP_XY, solver.FLIP_Z), ground=True)
    if name == "box":
        half = np.array([scenes.BOX_X / 2, scenes.BOX_Y / 2, scenes.BOX_HEIGHT])
        return solver.Body(
            _quarter_box(half, step),
            (solver.FLIP_X, solver.FLIP_Y, solver.FLIP_Z),
            liner=_quarter_box(half - INSET, 2.0 * step),
            ground=True,
        )
    plate = solver.rectangle([0, 0, 0], [scenes.PLATE_WIDTH / 2, 0, 0], [0, 0, scenes.PLATE_HEIGHT], step)
    radius, height = scenes.CYLINDER_RADIUS, scenes.CYLINDER_HEIGHT
    return solver.Body(
        (plate, *_half_cylinder(radius, height, step)),
        (solver.FLIP_X, solver.FLIP_Z),
        liner=_half_cylinder(radius - INSET, height - INSET, 2.0 * step),
        ground=True,
    )


def _quarter_box(half: F64, step: float) -> tuple[solver.Patch, ...]:
    x, y, z = np.diag(half)
    return (
        solver.rectangle(x, y, z, step),
        solver.rectangle(y, x, z, step),
        solver.rectangle(z, x, y, step),
    )


def _half_cylinder(radius: float, height: float, step: float) -> tuple[solver.Patch, ...]:
    y = scenes.CYLINDER_Y
    return (
        solver.barrel([0, y, 0], radius, height, step),
        solver.half_disc([0, y, height], radius, step),
    )


def solve(name: str, legs: float) -> dict[str, C128]:
    """Exact amplitudes of a scene for each of its cuts, from triangles with ``legs`` legs per wavelength."""
    cuts = scenes.SCENES[name].cuts
    print(f"{name}, {legs:g} legs per wavelength", flush=True)
    s = solver.amplitudes(body(name, 1.0 / legs), np.concatenate([cut.looks for cut in cuts]), say=print)
    ends = np.cumsum([cut.angle.size for cut in cuts])
    return {cut.name: part for cut, part in zip(cuts, np.split(s, ends[:-1]), strict=True)}


def compute(path: Path, names: Sequence[str]) -> None:
    """Solve scenes and write them into the reference beside those that it holds."""
    import resource  # not on Windows

    given = json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}
    for name in names:
        cpu, wall = time.process_time(), time.perf_counter()
        fine, *coarser = [solve(name, legs) for legs in LEGS[name]]
        given[name] = {
            "solver": solver.install(),
            "method": METHOD,
            "legs_per_wavelength": LEGS[name][0],
            "coarser_mesh": [
                {
                    "legs_per_wavelength": legs,
                    "rms_difference_db": {cut: mesh_error(coarse[cut], s) for cut, s in fine.items()},
                }
                for legs, coarse in zip(LEGS[name][1:], coarser, strict=True)
            ],
            "cpu_seconds": round(time.process_time() - cpu),
            "wall_seconds": round(time.perf_counter() - wall),
            # of the whole run up to here
            "peak_memory_gb": round(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20, 1),
            "amplitude": {
                cut: np.round(np.ascontiguousarray(s).view(np.float64), 3).tolist() for cut, s in fine.items()
            },
        }
        write(path, given)
        print(f"{name}: {given[name]['cpu_seconds']} CPU s", flush=True)


def write(path: Path, reference: dict[str, Any]) -> None:
    """Write the reference as JSON with one direction per line."""
    text = json.dumps(reference, indent=1)
    # rows of numbers on one line
    text = re.sub(r"\[\s+([-0-9.,\s]+?)\s+\]", lambda m: "[" + re.sub(r"\s+", " ", m[1]) + "]", text)
    path.write_text(text + "\n", encoding="utf-8")


def mesh_error(coarse: C128, fine: C128) -> dict[str, float]:
    """Rms difference of the levels within 20 and within 40 dB of the cut's peak, dB."""
    out = {}
    for i, channel in ((0, "HH"), (2, "VV")):
        a, b = (20.0 * np.log10(np.abs(s[:, i])) for s in (coarse, fine))
        for depth in (20.0, 40.0):
            keep = b >= b.max() - depth
            out[f"{channel} {depth:g}"] = round(float(np.sqrt(np.mean((a - b)[keep] ** 2))), 3)
    return out


# sectors over which powers are averaged, deg
SECTOR = 15.0
COLOURS = {"corner": "tab:blue", "box": "tab:orange", "cylinder": "tab:green"}


@harness.benchmark
def run(quick: bool, reference: Path = scenes.STORED) -> harness.Report:
    """Compare the simulator's automatic settings with the stored reference."""
    report = harness.Report(
        "full_wave",
        "Where physical optics ends",
        "Three metal scenes of 6 wavelengths on conducting ground, looked at from 1000 directions, against the "
        "electric field integral equation (bempp-cl, stored). Mean power is simulated over exact, averaged over "
        "directions; rms is of the levels' difference, direction by direction. Recompute the reference with "
        f"`{scenes.REMAKE}`: {_effort(reference)}.",
    )
    exact, pick = scenes.read_stored(reference), slice(None, None, 5 if quick else 1)
    bands, sectors, fringes = [], [], []
    figure, ax = harness.new_figure()
    for name, scene in scenes.SCENES.items():
        want = {cut: exact[name][cut.name][pick] for cut in scene.cuts}
        got = {cut: scenes.simulate_amplitudes(name, cut, pick) for cut in scene.cuts}
        whole = [np.concatenate([*part.values()]) for part in (want, got)]
        fringed = np.concatenate(
            [scenes.simulate_amplitudes(name, cut, pick, edges=True) for cut in scene.cuts]
        )
        fringes += _with_edges(name, *whole, fringed)
        for i, channel in ((0, "HH"), (2, "VV")):
            found = scenes.bands(whole[0][:, i], whole[1][:, i])
            bands += [
                [name, channel, f"{b.near:g} to {b.far:g}", b.n, f"{b.mean_db:+.2f}", b.rms_db] for b in found
            ]
            ax.plot(
                [b.near for b in found],
                [b.mean_db for b in found],
                "o-" if channel == "HH" else "s--",
                color=COLOURS[name],
                label=f"{name}, {channel}",
            )
        for cut in scene.cuts:
            sectors += _sectors(name, cut, cut.angle[pick], want[cut], got[cut])
        top = [scenes.bands(whole[0][:, i], whole[1][:, i])[0] for i in (0, 2)]
        report.claim(
            f"{name}: mean power within 3 dB of the peak, worse of HH and VV",
            max(abs(b.mean_db) for b in top),
            1.0,
            at_least=False,
            unit="dB",
        )
    report.table(
        "By level below the scene's peak",
        ("scene", "channel", "dB below peak", "directions", "mean power, dB", "rms, dB"),
        bands,
    )
    report.table(
        f"Mean power over sectors of {SECTOR:g} degrees, simulated over exact, dB (exact level, dB)",
        ("scene", "cut", "sector, deg", "HH", "VV"),
        sectors,
    )
    report.table(
        "Without and with the fringe currents of sharp edges, rms of the levels' difference, dB; error of the field "
        "over all directions, dB",
        ("scene", "channel", "dB below peak", "without", "with", "field without", "field with"),
        fringes,
    )
    ax.axhline(0.0, color="0.4", lw=0.8)
    ax.set_xlabel("exact level: from so many dB below the scene's peak")
    ax.set_ylabel("simulated over exact mean power (dB)")
    ax.legend(fontsize=8)
    report.figure("level", figure)
    report.notes.append(_convergence(reference))
    return report


def _with_edges(name: str, want: C128, without: C128, fringed: C128) -> list[list[str | float]]:
    """Rows of the table over edges."""
    rows: list[list[str | float]] = []
    for i, channel in ((0, "HH"), (2, "VV")):
        exact = want[:, i]
        field = [
            20.0 * np.log10(np.linalg.norm(s[:, i] - exact) / np.linalg.norm(exact))
            for s in (without, fringed)
        ]
        pairs = zip(scenes.bands(exact, without[:, i]), scenes.bands(exact, fringed[:, i]), strict=True)
        for a, b in pairs:
            level = f"{a.near:g} to {a.far:g}"
            rows.append([name, channel, level, a.rms_db, b.rms_db, *(f"{f:.1f}" for f in field)])
    return rows


def _convergence(reference: Path) -> str:
    """What the mesh of the stored solution leaves."""
    corner = json.loads(reference.read_text(encoding="utf-8"))["corner"]
    texts = []
    for coarse in corner["coarser_mesh"]:
        worst = max(
            v for cut in coarse["rms_difference_db"].values() for k, v in cut.items() if k.endswith(" 20")
        )
        texts.append(
            f"The corner's {corner['legs_per_wavelength']} triangles per wavelength against "
            f"{coarse['legs_per_wavelength']}: {worst:.2f} dB rms within 20 dB of a cut's peak, in the worst cut."
        )
    return " ".join(texts) + f" Solved with {corner['solver']}."


def _sectors(name: str, cut: scenes.DirectionCut, angle: Any, want: C128, got: C128) -> list[list[str]]:
    """Rows of the table over angle."""
    rows = []
    for low in np.arange(cut.first, cut.last, SECTOR):
        high = min(low + SECTOR, cut.last)
        here = (angle >= low) & ((angle < high) | (angle == cut.last) & (high == cut.last))
        exact, found = (
            10.0 * np.log10(np.mean(np.abs(s[here][:, [0, 2]]) ** 2, axis=0)) for s in (want, got)
        )
        cells = [f"{g - e:+.1f} ({e:.0f})" for e, g in zip(exact, found, strict=True)]
        rows.append([name, cut.name, f"{low:g} to {high:g}", *cells])
    return rows


def _effort(reference: Path) -> str:
    given = json.loads(reference.read_text(encoding="utf-8"))
    seconds = sum(given[name]["cpu_seconds"] for name in scenes.SCENES)
    memory = max(given[name]["peak_memory_gb"] for name in scenes.SCENES)
    return f"{seconds} CPU seconds and {memory:g} GB"


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--quick", action="store_true", help="every fifth direction")
    parser.add_argument("--reference", type=Path, default=scenes.STORED, help="file of exact amplitudes")
    parser.add_argument(
        "--compute", type=Path, metavar="FILE", help="solve the scenes and write the reference"
    )
    parser.add_argument("--scene", choices=tuple(scenes.SCENES), action="append", help="compute these only")
    parser.add_argument("-o", "--output", type=Path, default=harness.RESULTS)
    args = parser.parse_args()
    if args.compute:
        if not solver.install():
            parser.error("--compute needs bempp-cl and an OpenCL driver: pip install '.[full-wave]'")
        compute(args.compute, args.scene or tuple(scenes.SCENES))
        return 0
    from sarmitsuba.core.errors import SarmitsubaWarning
    from sarmitsuba.machine.backend import ensure_backend

    warnings.simplefilter("ignore", SarmitsubaWarning)
    ensure_backend()
    run(args.quick, args.reference).save(args.output)
    return 0


if __name__ == "__main__":
    sys.exit(main())
