"""Levels, permittivities and roughness of Munich's materials from one quad-pol raw data set: spread against the bound.

    python -m benchmarks.studies.munich_materials --seed 300 -o out/munich_materials

Every building of Munich draws one of twelve wall and one of twelve roof materials; the ground is of one more. Walls and
ground scatter by Lambert's law and mirror as rough dielectrics, so that each has a level, a permittivity and an rms
height; roofs scatter by the small-slope law, which follows from permittivity and rms height. One raw data set in four
channels, noise 20 dB below it, and starts that are off by up to 3 dB in level and 20 % in the others. Every value has a
prior as wide as these starts are off. A value counts as determined where the data say more than the prior: a bound of
at most half the prior's standard deviation; the others are named.

Prints the rms error over the draws of noise over the Cramer-Rao bound, by kind, what of it chance alone makes, and time
and memory beside those of a plain run. Writes ``munich_materials.json`` and ``munich_materials.png``.
"""

import argparse
import json
import sys
import time
import warnings
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import scipy

from benchmarks.support.munich_materials_drawn import KINDS, SMALL, WHOLE, drawn, parameters_of, started
from sarmitsuba import Fit, Prior, RawData, Scene, fit, simulate
from sarmitsuba.apps.fit.forward_model import ForwardModel
from sarmitsuba.apps.fit.parsing import parse
from sarmitsuba.core.arrays import F64
from sarmitsuba.machine.memory import peak_memory
from tests.support.fits import noisy

SNR_DB = 20.0
# a value is determined where the bound of the data alone is at most this share of the prior's standard deviation
DETERMINED = 0.5
TARGET = 1.5


def main() -> None:
    """Fit all draws and print the tables."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seed", type=int, default=300, help="of materials, starts and noise")
    parser.add_argument("--draws", type=int, default=0, help="draws of noise (default: 10; 2 with --small)")
    parser.add_argument("--small", action="store_true", help="seven materials of a few buildings, 8 pulses")
    parser.add_argument(
        "--rms-heights",
        nargs=2,
        type=float,
        default=(2.0, 4.5),
        metavar="MM",
        help="of all surfaces (default: 2 4.5)",
    )
    parser.add_argument("-o", "--output", type=Path, default=Path("out/munich_materials"))
    args = parser.parse_args()
    warnings.simplefilter("ignore")
    size, draws = (SMALL, args.draws or 2) if args.small else (WHOLE, args.draws or 10)
    low, high = (1e-3 * x for x in args.rms_heights)
    scene = drawn(args.seed, size, (low, high))
    if scene is None:
        sys.exit("munich_materials: the package sionna-rt, which carries the scene, is not installed")
    args.output.mkdir(parents=True, exist_ok=True)
    record = study(scene, args.seed, draws)
    (args.output / "munich_materials.json").write_text(json.dumps(record, indent=1), encoding="utf-8")
    picture(args.output / "munich_materials.png", record)
    print(args.output / "munich_materials.png")


def study(scene: Scene, seed: int, draws: int) -> dict[str, Any]:
    """Fit all draws; print and return the figures."""
    start, truth, priors = started(scene, seed)
    text = parameters_of(scene)
    cost = costs(start, text)
    raw = simulate(scene)
    layers = raw.data.astype(np.complex64)
    model = ForwardModel(start, parse(text, start))
    apart = float(np.mean(np.abs(layers - model.data(truth)) ** 2) / np.mean(np.abs(layers) ** 2))
    print(
        f"{len(scene.materials)} materials, {len(truth)} values, data {' x '.join(str(n) for n in model.shape)}; "
        f"simulated data less those of the model with the true values: {10.0 * np.log10(max(apart, 1e-30)):.0f} dB",
        flush=True,
    )
    fits, seconds = [], []
    for draw in range(draws):
        begun = time.process_time()
        fits.append(_fitted(start, raw, text, priors, 1000 * seed + draw))
        seconds.append(time.process_time() - begun)
        off = (fits[-1].values - truth) / fits[-1].bound
        print(
            f"draw {draw}: {len(fits[-1].costs) - 1} steps, converged {fits[-1].converged}, rms error over bound "
            f"{np.sqrt(np.mean(off**2)):.2f}, {seconds[-1]:.0f} CPU s",
            flush=True,
        )
    cost |= {"fit_cpu_s": float(np.median(seconds)), "fit_peak_gb": peak_memory() / 1e9}
    return _record(
        fits, truth, [p.sigma for p in priors.values()], cost, seed, float(10.0 * np.log10(max(apart, 1e-30)))
    )


def _fitted(start: Scene, raw: RawData, text: str, priors: dict[str, Prior], seed: int) -> Fit:
    """A fit to the data with drawn noise, of which the radar knows the power."""
    data, temperature = noisy(raw, SNR_DB, seed)
    radar = replace(start.radar, noise_temperature=temperature)
    return fit(replace(start, radar=radar), data, text, priors=priors)


def costs(scene: Scene, text: str) -> dict[str, float]:
    """Processor seconds and peak memory of data alone and of data with derivatives, both compiled before."""
    found: dict[str, float] = {}
    model = ForwardModel(scene, parse(text, scene))
    for name, job in (("plain", model.data), ("jacobian", model.derivative)):
        job()
        begun = time.process_time()
        job()
        found |= {f"{name}_cpu_s": time.process_time() - begun, f"{name}_peak_gb": peak_memory() / 1e9}
    return found


def _record(
    fits: Sequence[Fit],
    truth: F64,
    prior: Sequence[float],
    cost: dict[str, float],
    seed: int,
    apart_db: float,
) -> dict[str, Any]:
    """Print the table and return the figures."""
    names = fits[0].names
    values = np.array([f.values for f in fits])
    bound = np.sqrt(np.mean([f.bound**2 for f in fits], axis=0))
    # the bound has the prior; without it, the two add as inverse variances
    determined = bound <= DETERMINED * np.asarray(prior) / np.sqrt(1.0 + DETERMINED**2)
    ratio = np.sqrt(np.mean((values - truth) ** 2, axis=0)) / bound
    # how often rms over the draws of a normal error of that sigma is above the target
    chance = float(scipy.stats.chi2.sf(len(fits) * TARGET**2, len(fits)))

    print("\nrms error over the draws, over the bound")
    print(f"{'kind':13} {'values':>6} {'determined':>10} {'rms':>6} {'largest':>8}  bound, median")
    for kind, unit in (*KINDS.items(), ("", "")):
        mine = np.array([name.startswith(kind) for name in names])
        kept = mine & determined
        line = f"{kind or 'all':13} {mine.sum():6d} {kept.sum():10d}"
        if kept.any():
            line += f" {_rms(ratio[kept]):6.2f} {ratio[kept].max():8.2f}"
            if kind == "level":
                line += f"  {np.median(bound[kept]):.2g} {unit}"
            elif kind:
                line += f"  {100.0 * np.median((bound / np.abs(truth))[kept]):.2g} %"
        print(line)
    over = int((ratio[determined] > TARGET).sum())
    expected = chance * determined.sum()
    print(f"above {TARGET:g}: {over} of {determined.sum()}; by chance alone {expected:.1f}")
    left = [names[k] for k in np.flatnonzero(~determined)]
    print(f"left to their priors: {', '.join(left) or 'none'}")
    for name in ("plain", "jacobian", "fit"):
        print(f"{name:9} {cost[f'{name}_cpu_s']:7.2f} CPU s, {cost[f'{name}_peak_gb']:5.2f} GB at most")
    return {
        "seed": seed,
        "names": list(names),
        "truth": truth.tolist(),
        "start": fits[0].start.tolist(),
        "values": values.tolist(),
        "bound": bound.tolist(),
        "determined": determined.tolist(),
        "ratio": ratio.tolist(),
        "steps": [len(f.costs) - 1 for f in fits],
        **cost,
    }


def _rms(x: F64) -> float:
    return float(np.sqrt(np.mean(x**2)))


def picture(path: Path, record: dict[str, Any]) -> None:
    """Found against true values with their spread, and the start values."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(15.0, 4.6), dpi=100, layout="constrained")
    truth, start = np.array(record["truth"]), np.array(record["start"])
    values = np.array(record["values"])
    determined = np.array(record["determined"])
    titles = ("level (dB)", "permittivity, real part", "rms height (mm)")
    for axes, kind, title in zip(figure.subplots(1, len(KINDS)), KINDS, titles, strict=True):
        mine = np.array([name.startswith(kind + ":") for name in record["names"]])
        scale = 1e3 if kind == "rms_height" else 1.0
        ends = scale * np.array([truth[mine].min(), truth[mine].max()])
        axes.plot(ends, ends, color="0.6", lw=0.8)
        axes.plot(scale * truth[mine], scale * start[mine], "x", color="tab:red", ms=5, label="start")
        for some, colour, label in (
            (mine & ~determined, "0.6", "left to the prior"),
            (mine & determined, "tab:blue", "found: mean and spread of the draws"),
        ):
            if some.any():
                mean, spread = scale * values[:, some].mean(axis=0), scale * values[:, some].std(axis=0)
                axes.errorbar(
                    scale * truth[some],
                    mean,
                    spread,
                    fmt="o",
                    ms=4,
                    capsize=2,
                    color=colour,
                    label=label,
                )
        axes.set(title=title, xlabel="true", ylabel="found")
        axes.grid(alpha=0.3)
    figure.axes[0].legend(fontsize=8)
    kept = np.array(record["ratio"])[determined]
    figure.suptitle(
        f"Munich, {len(truth)} values from one quad-pol raw data set at {SNR_DB:g} dB, {len(values)} draws of noise: "
        f"rms error {_rms(kept):.2f} of the Cramer-Rao bound",
        fontsize=10,
    )
    figure.savefig(path)


if __name__ == "__main__":
    main()
