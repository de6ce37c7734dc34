"""Reverse mode: a map of 64 x 64 levels found from noisy raw data, and what a gradient by many heights costs.

Usage: python -m benchmarks.studies.reverse [--seed N] [--side N] [--steps N] [--figure PNG] [--json FILE]
       [--tables map|heights ...] [--bodies N ...]

``map``: level ground whose sigma0 is a bitmap of fields, a lane and a gentle slope; raw data at 20 dB of signal over
noise; SciPy's L-BFGS-B with ``sarmitsuba.Objective`` from a flat map. The error of the texels, in dB, beside the
Cramer-Rao bound (of four patches of texels, from their Jacobians) and beside what the mean of as many looks of unknown
speckle allows, 10 / ln 10 / sqrt(looks); seconds and memory beside a plain run. ``heights``: boxes in streets. The
gradient by all their heights against the Jacobian's, and processor time of both over that of a plain run.
"""

import argparse
import json
import statistics
import time
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import scipy.optimize
from numpy.typing import NDArray

from sarmitsuba import Scene, SquaredDifference
from sarmitsuba.apps.fit.forward_model import ForwardModel
from sarmitsuba.apps.fit.material_parameters import LevelMap
from sarmitsuba.apps.fit.parsing import parse
from sarmitsuba.apps.fit.reverse import Objective, apply_transpose
from sarmitsuba.core.arrays import F64
from sarmitsuba.machine.memory import peak_memory
from tests.support.fits import noisy
from tests.support.many_bodies import adjoint_of, city, products

# m of a texel, dB of signal over noise, fields in the map, and the pulses and band that image it at 0.75 m
TEXEL, SNR_DB, FIELDS, PULSES, BANDWIDTH = 2.0, 20.0, 14, 208, 200e6
# texels along a side of the patches whose bound is computed, and their rims, which are left out
PATCH, RIM = 16, 4
# texels at the map's edge, half of which lie outside the image
EDGE = 3
ROUNDS = 5


@dataclass(frozen=True)
class TexelPatch(LevelMap):
    """Levels of a square patch of a map: its first row and column, and its side."""

    row: int = 0
    column: int = 0
    side: int = 1

    def _places(self, scene: Scene) -> list[int]:
        rows, columns = self._own(scene)[1].values.shape
        assert self.row + self.side <= rows and self.column + self.side <= columns
        own = range(self.side)
        return [(self.row + i) * columns + self.column + j for i in own for j in own]

    def names(self, scene: Scene) -> tuple[str, ...]:
        """Of the patch's texels."""
        every = super().names(scene)
        return tuple(every[k] for k in self._places(scene))

    def values(self, scene: Scene) -> F64:
        """Of the patch's texels, dB."""
        return np.asarray(super().values(scene)[self._places(scene)])

    def texels(self, scene: Scene) -> Sequence[tuple[int, int]]:
        """Of the patch."""
        every = super().texels(scene)
        return [every[k] for k in self._places(scene)]


# boxes up to which the Jacobian with moving edges is computed
MOST_WITH_EDGES = 10


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seed", type=int, default=700, help="of scenes and noise")
    parser.add_argument("--side", type=int, default=64, help="texels along a side of the map")
    parser.add_argument("--steps", type=int, default=120, help="most steps of the optimiser")
    parser.add_argument("--bodies", type=int, nargs="+", default=[4, 10, 40, 100], help="boxes")
    parser.add_argument("--tables", nargs="+", default=["map", "heights"], help="which tables")
    parser.add_argument("--figure", help="file for the picture of the maps")
    parser.add_argument("--json", help="file for the numbers")
    args = parser.parse_args()
    warnings.simplefilter("ignore")
    record: dict[str, object] = {}
    if "map" in args.tables:
        record["map"] = found_map(args.seed, args.side, args.steps, args.figure)
    if "heights" in args.tables:
        record["heights"] = heights(args.seed, args.bodies)
    if args.json:
        with open(args.json, "w", encoding="utf-8") as file:
            json.dump(record, file, indent=1)


def drawn_levels(seed: int, side: int) -> F64:
    """Levels of fields within 4 dB, nearest to drawn places, a lane of -6 dB across, and a slope of 2 dB; dB."""
    rng = np.random.default_rng([seed, 0x3A9])
    row, column = np.meshgrid(np.arange(side), np.arange(side), indexing="ij")
    places, levels = rng.uniform(0.0, side, (FIELDS, 2)), rng.uniform(-4.0, 4.0, FIELDS)
    nearest = np.argmin([(row - r) ** 2 + (column - c) ** 2 for r, c in places], axis=0)
    out = levels[nearest] + 2.0 * (column / side - 0.5)
    angle = rng.uniform(0.3, 1.2)
    across = (row - 0.5 * side) * np.cos(angle) - (column - 0.5 * side) * np.sin(angle)
    out[np.abs(across) < 1.5] = -6.0
    return np.asarray(out)


def found_map(seed: int, side: int, steps: int, figure: str | None) -> dict[str, object]:
    """Print how well a map of levels is found."""
    truth = drawn_levels(seed, side)
    radar = {"n_pulses": PULSES * side // 64, "bandwidth": BANDWIDTH}
    settings = {"key_pulse_interval": 16, "max_depth": 1}
    pitch = TEXEL * side
    scene = city(seed, 0, pitch=pitch, levels=np.zeros((side, side)), radar=radar, settings=settings)
    model = ForwardModel(scene, parse("level_map:soil", scene))
    data = model.data(truth.reshape(-1))
    raw, _ = noisy(model.raw(data), SNR_DB, seed)
    power = float(np.mean(np.abs(data) ** 2)) * 10.0 ** (-0.1 * SNR_DB)
    wave = scene.radar.waveform
    samples = float(wave.range_cell / scene.radar.window.sample_spacing)
    loss = SquaredDifference(raw.data, weights=np.asarray(1.0 / (power * samples)))
    objective = Objective(scene, "level_map:soil", loss)
    plain = timed(lambda: model.data(model.start))
    before = peak_memory()
    both = timed(lambda: objective(model.start))
    memory = objective.at(model.start).memory
    errors: list[float] = []
    inner = np.s_[EDGE : side - EDGE, EDGE : side - EDGE]

    def note(values: F64) -> None:
        errors.append(rms(values.reshape(side, side)[inner] - truth[inner]))

    start = time.process_time()
    done = scipy.optimize.minimize(
        objective,
        model.start,
        jac=True,
        method="L-BFGS-B",
        callback=note,
        options={"maxiter": steps, "ftol": 1e-12},
    )
    seconds = time.process_time() - start
    found, after = done.x.reshape(side, side), peak_memory()
    bound, patch = patch_bounds(scene, truth, power * samples)
    left = [objective.at(x).loss for x in (model.start, done.x, truth.reshape(-1))]
    speckle = looks_bound(scene)
    print(
        f"map of {side} x {side} levels, texels of {TEXEL:g} m, {model.shape[1]} pulses of {model.shape[2]} samples, "
        f"{SNR_DB:g} dB\n"
        f"rms error, dB: start {rms(truth[inner]):.2f}, after 10 steps {errors[min(9, len(errors) - 1)]:.2f}, after "
        f"{done.nit} {errors[-1]:.2f}, least on the way {min(errors):.2f}; median of |error| "
        f"{np.median(np.abs(found - truth)[inner]):.2f}\n"
        f"four patches: rms error {rms((found - truth)[patch]):.2f}, bound {bound:.2f} dB; mean of unknown "
        f"speckle {speckle:.2f} dB\n"
        f"loss: start {left[0]:.0f}, found {left[1]:.0f}, truth {left[2]:.0f}\n"
        f"plain run {plain:.2f} s, loss and gradient {both:.2f} s ({both / plain:.2f}), {done.nfev} of them in "
        f"{seconds:.0f} s of processor time\n"
        f"adjoint grids and gradient {memory / 1e6:.1f} MB; peak memory {before / 1e6:.0f} MB with plain runs, "
        f"{after / 1e6:.0f} MB with gradients\n"
    )
    if figure:
        plot(truth, model.start.reshape(side, side), found, figure)
    return {
        "rms_db": errors,
        "patch_db": rms((found - truth)[patch]),
        "bound_db": bound,
        "speckle_db": speckle,
        "ratio": both / plain,
        "seconds": seconds,
        "runs": done.nfev,
        "memory": memory,
    }


def rms(values: F64) -> float:
    """Root of the mean square."""
    return float(np.sqrt(np.mean(values**2)))


def timed(run: Callable[[], object]) -> float:
    """Median processor seconds of a run, the first of which compiles and does not count."""
    run()
    taken = []
    for _ in range(ROUNDS):
        start = time.process_time()
        run()
        taken.append(time.process_time() - start)
    return statistics.median(taken)


def patch_bounds(scene: Scene, truth: F64, variance: float) -> tuple[float, NDArray[np.bool_]]:
    """Cramer-Rao bound of a texel, dB, rms over four patches of the map without their rims, and those texels."""
    side = len(truth)
    wide = min(PATCH, side // 2)
    rim = min(RIM, (wide - 1) // 2)
    (whole,) = parse("level_map:soil", scene)
    at = whole.changed(scene, truth.reshape(-1))
    sigma = np.full(truth.shape, np.nan)
    for row in (side // 4, 3 * side // 4):
        for column in (side // 4, 3 * side // 4):
            first = row - wide // 2, column - wide // 2
            _, planes = ForwardModel(at, [TexelPatch("soil", *first, wide)]).derivative()
            rows = planes.reshape(len(planes), -1).astype(np.complex128)
            normal = (rows.conj() @ rows.T).real
            own = np.sqrt(np.diag(np.linalg.inv(2.0 * normal / variance))).reshape(wide, wide)
            places = tuple(slice(f + rim, f + wide - rim) for f in first)
            sigma[places] = own[rim : wide - rim, rim : wide - rim]
    known = np.isfinite(sigma)
    return rms(sigma[known]), known


def looks_bound(scene: Scene) -> float:
    """Standard deviation of a texel's level, dB, from the mean intensity of its independent looks."""
    radar = scene.radar
    middle = radar.track.position[radar.track.n_pulses // 2]
    ground = radar.waveform.range_cell / np.sin(np.arccos(middle[2] / np.linalg.norm(middle)))
    ends = radar.track.position[[0, -1]]
    turn = np.arccos(np.clip(ends[0] @ ends[1] / np.prod(np.linalg.norm(ends, axis=1)), -1.0, 1.0))
    along = radar.waveform.wavelength / (2.0 * turn)
    return float(10.0 / np.log(10.0) / np.sqrt(TEXEL * TEXEL / (ground * along)))


def heights(seed: int, bodies: Sequence[int]) -> list[dict[str, Any]]:
    """Print the cost of gradients by heights, and how far they are from the Jacobian's."""
    print(
        f"gradient by the heights of boxes, seed {seed}; over a plain run: without, with moving edges\n"
        f"{'boxes':>5} {'plain, s':>9} {'gradient':>19} {'jacobian':>19} {'worst difference':>17}"
    )
    lines: list[dict[str, Any]] = []
    for n in bodies:
        scene = city(seed, n, radar={"n_pulses": 64}, settings={"key_pulse_interval": 16})
        model = ForwardModel(scene, parse("heights", scene))
        plain = timed(model.data)
        line: dict[str, Any] = {"bodies": n, "plain": plain}
        # a Jacobian of many shapes finds the same points on edges many times
        for edges in (False, True) if n <= MOST_WITH_EDGES else (False,):
            data, planes = model.derivative(edges=edges)
            adjoint = adjoint_of(np.random.default_rng(seed), data)
            found, line["memory"] = apply_transpose(model, adjoint, edges=edges)
            expected, size = products(adjoint, planes)
            line["worst"] = float(np.max(np.abs(found - expected)[size > 0.0] / size[size > 0.0]))
            del planes
        for edges, name in ((False, ""), (True, "_with_edges")):
            line["gradient" + name] = timed(partial(apply_transpose, model, adjoint, edges=edges)) / plain
            if not edges or n <= MOST_WITH_EDGES:
                line["jacobian" + name] = timed(partial(model.derivative, edges=edges)) / plain
        texts = [
            f"{line.get(name, np.nan):9.2f} {line.get(name + '_with_edges', np.nan):9.2f}"
            for name in ("gradient", "jacobian")
        ]
        print(f"{n:5d} {line['plain']:9.2f} {texts[0]} {texts[1]} {line['worst']:17.1e}", flush=True)
        lines.append(line)
    return lines


def plot(truth: F64, start: F64, found: F64, path: str) -> None:
    """Draw the three maps."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(1, 3, figsize=(9.6, 3.4), layout="constrained")
    low, high = np.floor(truth.min()) - 1.0, np.ceil(truth.max()) + 1.0
    for axis, name, values in zip(axes, ("truth", "start", "found"), (truth, start, found), strict=True):
        shown = axis.imshow(values, vmin=low, vmax=high, cmap="viridis")
        axis.set_title(name)
        axis.set_xticks([])
        axis.set_yticks([])
    figure.colorbar(shown, ax=axes, label="level, dB", shrink=0.9)
    figure.savefig(path, dpi=110)
    plt.close(figure)


if __name__ == "__main__":
    main()
