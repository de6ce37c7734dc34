"""Sampling error of the samples of a recipe by their spacing of rays: why a recipe gives ``ray_spacing``.

Usage: python -m benchmarks.studies.chip_ray_spacing [RECIPE] [--samples N] [--spacings M ...]

Each sample is made with each spacing, 0 being the automatic one, and its sampling error measured from a second image
with other rays, as ``error_every`` of a recipe does. Shown are the mean in dB, the mean of the energies in dB (the
worst samples decide it), the three worst, the share above -12 dB, and the processor time of a sample without its
second image.
"""

import argparse
import statistics
import warnings
from dataclasses import replace

import numpy as np

from sarmitsuba.apps.dataset_draw import Drawer
from sarmitsuba.apps.dataset_recipe import Fixed
from sarmitsuba.apps.dataset_sample import make_sample
from sarmitsuba.machine.backend import ensure_backend


def drawer_of(name: str, spacing: float, every: int) -> Drawer:
    """Drawer of a recipe with another spacing of rays, m, that measures the error of every so many samples."""
    recipe = Drawer.of(name).recipe
    tracing = recipe.sections["tracing"]
    tracing = replace(tracing, drawn={**tracing.drawn, "ray_spacing": Fixed(spacing)})
    values = {**recipe.values, "dataset": {**recipe.values["dataset"], "error_every": every}}
    return Drawer(replace(recipe, values=values, sections={**recipe.sections, "tracing": tracing}))


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("recipe", nargs="?", default="vehicles_and_boats")
    parser.add_argument("--samples", type=int, default=100)
    parser.add_argument("--spacings", type=float, nargs="+", default=[0.0, 0.05])
    args = parser.parse_args()
    warnings.simplefilter("ignore")
    ensure_backend()
    print(f"{args.recipe}: {args.samples} samples")
    print(
        "| ray spacing, m | mean error, dB | of mean energy, dB | worst, dB | above -12 dB, % | processor s |"
    )
    print("|---|---|---|---|---|---|")
    for spacing in args.spacings:
        measuring, plain = (drawer_of(args.recipe, spacing, every) for every in (1, 0))
        found = [make_sample(measuring, n).sampling_error_db.values() for n in range(args.samples)]
        error = np.array([max(one) for one in found])
        # the first ones load kernels
        seconds = statistics.median(make_sample(plain, n).seconds for n in range(min(20, args.samples)))
        worst = ", ".join(f"{v:.1f}" for v in np.sort(error)[::-1][:3])
        energy = 10.0 * np.log10(np.mean(10.0 ** (error / 10.0)))
        print(
            f"| {spacing:g} | {error.mean():.1f} | {energy:.1f} | {worst} | {100.0 * np.mean(error > -12.0):.0f} | "
            f"{seconds:.2f} |",
            flush=True,
        )


if __name__ == "__main__":
    main()
