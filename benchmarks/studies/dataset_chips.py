"""Chips of a data set per hour by method, with labels: processor time, errors and kernels compiled.

Usage: python -m benchmarks.studies.dataset_chips [--chips N] [--methods raster image hybrid]

Every method makes the same drawn scenes: a car-like body at any aspect on soil, grass or asphalt, up to three boxes,
two looks, 128 x 128 pixels of 0.25 m, with the labels shape and layover_shadow, rays
0.05 m apart. Processor seconds of a chip are means
over all but the first tenth, which compiles and loads kernels; chips per hour are those of two processors that do
nothing else. The sampling error is the median over every tenth chip, from a second image with other rays; the energy of
omitted waves is what the program states of its theory, over the image's energy. Method raster has no phase and one
bounce: what it leaves out is shown as the median level of its difference in intensity from hybrid, averaged over 4 x 4
pixels, in dB of hybrid's energy.
"""

import argparse
import importlib
import statistics
import tempfile
import time
import warnings
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sarmitsuba.apps.dataset_draw import Drawer
from sarmitsuba.apps.dataset_sample import Sample, make_sample
from sarmitsuba.machine.backend import dr, ensure_backend

RECIPE = """
[dataset]
samples = 100000
seed = 7
error_every = {every}
[labels]
layers = "shape, layover_shadow"
[objects]
meshes = "targets/vehicle"
heading_deg = {{ uniform = [0, 360] }}
spread = 4.0
[ground]
material = {{ choice = ["soil", "grass", "asphalt"] }}
[clutter]
count = {{ uniform = [0, 3] }}
spread = 24.0
[radar]
slant_range = 8000.0
look_angle_deg = {{ choice = [40.0, 55.0] }}
bandwidth = 400e6
azimuth_resolution = 0.4
[film]
pixel_spacing_azimuth = 0.25
pixel_spacing_range = 0.25
[tracing]
method = "{method}"
ray_spacing = 0.05
"""
BLOCK = 4


def drawer_of(folder: Path, method: str, every: int) -> Drawer:
    path = folder / f"{method}_{every}.toml"
    path.write_text(RECIPE.format(method=method, every=every), encoding="utf-8")
    return Drawer.of(str(path))


def intensity(sample: Sample) -> NDArray[np.float64]:
    power = np.abs(sample.image[0].astype(np.complex128)) ** 2
    return power.reshape(power.shape[0] // BLOCK, BLOCK, -1, BLOCK).mean(axis=(1, 3))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--chips", type=int, default=100)
    parser.add_argument("--methods", nargs="+", default=["raster", "image", "hybrid"])
    args = parser.parse_args()
    warnings.simplefilter("ignore")
    ensure_backend()
    flags = importlib.import_module("drjit").JitFlag
    dr.set_flag(flags.KernelHistory, True)
    first = args.chips // 10
    shown = {}
    print("| method | processor s a chip | chips an hour on two processors | kernels compiled after the first tenth |"
          " sampling error dB | omitted waves dB | difference from hybrid dB |")  # fmt: skip
    print("|---|---|---|---|---|---|---|")
    with tempfile.TemporaryDirectory() as name:
        for method in args.methods[::-1]:
            drawer = drawer_of(Path(name), method, 0)
            seconds, known, late, omitted = [], set(), set(), []
            for number in range(args.chips):
                dr.kernel_history_clear()
                begin = time.process_time()
                sample = make_sample(drawer, number)
                if number >= first:
                    seconds.append(time.process_time() - begin)
                found = {k["hash"] for k in dr.kernel_history([dr.KernelType.JIT])}
                late |= found - known if number >= first else set()
                known |= found
                omitted += sample.omitted_db.values()
                shown[method, number] = intensity(sample)
            measuring = drawer_of(Path(name), method, 10)
            errors = [
                v
                for n in range(0, args.chips, 10)
                for v in make_sample(measuring, n).sampling_error_db.values()
            ]
            apart = [
                float(((shown[method, n] - other) ** 2).sum() / (other**2).sum())
                for n in range(args.chips)
                if (other := shown.get(("hybrid", n))) is not None and method != "hybrid"
            ]
            cost = statistics.mean(seconds)
            row = [
                method,
                f"{cost:.3f}",
                f"{2 * 3600 / cost:.0f}",
                str(len(late)),
                f"{statistics.median(errors):.1f}" if errors else "-",
                f"{statistics.median(omitted):.1f}" if omitted else "-",
                f"{10 * np.log10(statistics.median(apart)):.1f}" if apart else "-",
            ]
            print(f"| {' | '.join(row)} |", flush=True)


if __name__ == "__main__":
    main()
