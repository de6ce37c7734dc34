"""Sparse image of points from a third of the pulses, by iterative soft thresholding with a focusing operator.

Usage: python -m benchmarks.studies.sparse_image [--focuser NAME] [--seed N] [--figure PNG] [--times]

Points at drawn places off the pixels, noise, and two thirds of the pulses missing at random. The operator A of a
focuser without windows gives the model of the data, s A^H x; FISTA (Beck and Teboulle, SIAM J. Imaging Sci. 2 (2009)
183) finds the pixels x of least absolute sum that explain the recorded pulses. The missing pulses are made from them,
and the whole is focused with the default window. Compared are images with that of all pulses without noise: their
error, and the highest level away from all points. ``--times`` prints instead, for every focuser, the processor time of
a product with A and with its adjoint on noise, and the relative difference of <A x, A x> and <A^H A x, x>.
"""

import argparse
import time
from dataclasses import replace

import numpy as np

import sarmitsuba
from sarmitsuba.core.arrays import C64, F32, F64
from sarmitsuba.loading.build import build_scene
from sarmitsuba.radar.description import RadarDescription
from sarmitsuba.radar.film import FilmDescription
from sarmitsuba.scene.geometry import PointTarget
from sarmitsuba.signal.focusing import FOCUSERS
from sarmitsuba.signal.focusing.ideal import ideal_echoes, ideal_radar
from sarmitsuba.signal.focusing.operator import FocusingOperator, focusing_operator
from sarmitsuba.signal.image import SarImage
from sarmitsuba.signal.metrics import image_error_db
from sarmitsuba.signal.raw_data import Layer, RawData

# m: resolution, and side of the image
CELL, SIZE = 0.5, 20.0
POINTS, PRESENT, SNR_DB = 12, 1.0 / 3.0, 30.0
# FISTA's rounds, and its threshold over the largest correlation of a pixel with the data
ROUNDS, THRESHOLD = 150, 0.02


def drawn_data(seed: int) -> tuple[RawData, F64]:
    """Noise-free echoes of points of drawn places and levels, and their places (n, 3), m."""
    rng = np.random.default_rng(seed)
    radar = RadarDescription(
        mode="spotlight",
        slant_range=5000.0,
        look_angle_deg=45.0,
        bandwidth=300e6,
        azimuth_resolution=CELL,
        speed=100.0,
        pattern="isotropic",
    )
    film = FilmDescription(image_grid="ground", image_extent_azimuth=SIZE, image_extent_range=SIZE)
    scene = build_scene(points=[PointTarget("aim", np.zeros(3), 1.0)], radar=radar, film=film)
    places = np.zeros((POINTS, 3))
    places[:, :2] = rng.uniform(-0.4 * SIZE, 0.4 * SIZE, (POINTS, 2))
    levels, phases = 10.0 ** rng.uniform(-1.0, 0.0, POINTS), rng.uniform(0.0, 2.0 * np.pi, POINTS)
    return replace(ideal_echoes(scene.radar, places, levels, phases), request=scene.image), places


def sparse_pixels(operator: FocusingOperator, data: C64, present: F32) -> tuple[C64, float]:
    """Pixels of least absolute sum whose echoes are the data in the pulses present, and s of the model s A^H."""
    unit = np.zeros(operator.image_shape, dtype=np.complex64)
    unit[tuple(n // 2 for n in unit.shape)] = 1.0
    # an echo of unit RCS has the peak 1 in its image
    scale = 1.0 / float(np.linalg.norm(operator.H @ unit.ravel()) ** 2)

    def model(x: C64) -> C64:
        return np.asarray(scale * (operator.H @ x) * present)

    def adjoint(d: C64) -> C64:
        return np.asarray(scale * (operator @ (d * present)))

    x = adjoint(data)
    tau = THRESHOLD * float(np.abs(x).max())
    for _ in range(12):  # power iteration
        lipschitz = float(np.linalg.norm(x))
        x = adjoint(model(x / lipschitz))
    lipschitz = 1.05 * float(np.linalg.norm(x))
    x = old = ahead = np.zeros_like(x)
    t = 1.0
    for _ in range(ROUNDS):
        step = ahead - adjoint(model(ahead) - data * present) / lipschitz
        level = np.abs(step)
        x = step * (np.maximum(level - tau / lipschitz, 0.0) / np.maximum(level, 1e-30))
        after = 0.5 * (1.0 + np.sqrt(1.0 + 4.0 * t * t))
        ahead = x + (t - 1.0) / after * (x - old)
        old, t = x, after
    # least squares on the pixels found takes the threshold's bias out
    found = (np.abs(x) > 0.0).astype(np.float32)
    rest = data * present - model(x)
    for _ in range(ROUNDS):
        x = x + found * adjoint(rest) / lipschitz
        rest = data * present - model(x)
    return np.asarray(x, dtype=np.complex64), scale


def highest_away(image: SarImage, places: F64) -> float:
    """Highest level (dB) of an image more than four cells from all points."""
    away = np.ones(image.grid.shape, dtype=bool)
    for place in places:
        away &= np.linalg.norm(image.grid.positions() - place, axis=-1) > 4.0 * CELL
    return float(20.0 * np.log10(np.abs(image.data[0])[away].max()))


def print_times() -> None:
    """Print processor times of the products, and how exact the adjoints are, of one layer of noise."""
    radar = ideal_radar(slant_range=10e3, resolution=0.5, bandwidth=300e6, n_samples=700)
    rng = np.random.default_rng(1)
    shape = (1, radar.track.n_pulses, radar.window.n_samples)
    x = (rng.standard_normal(shape) + 1j * rng.standard_normal(shape)).astype(np.complex64)
    raw = RawData(x, (Layer("VV"),), "compressed", radar)
    request = {"grid": "slant", "extent_azimuth": 100.0, "extent_range": 100.0}
    print(f"{shape[1]} pulses of {shape[2]} samples")
    print("| focuser | pixels | A, CPU s | A^H, CPU s | difference |\n|---|---|---|---|---|")
    for focuser in FOCUSERS:
        operator = focusing_operator(raw, request=request, focuser=focuser)
        image = operator @ x.ravel()
        operator.H @ image  # compiles
        start = time.process_time()
        operator @ x.ravel()
        middle = time.process_time()
        back = operator.H @ image
        end = time.process_time()
        power = np.vdot(image.astype(np.complex128), image)
        off = abs(np.vdot(back.astype(np.complex128), x) - power) / abs(power)
        pixels = " x ".join(str(n) for n in operator.grid.shape)
        print(f"| {focuser.name} | {pixels} | {middle - start:.2f} | {end - middle:.2f} | {off:.0e} |")


def main() -> None:
    """Print the figures of the three images, and plot them."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--focuser", default="omega_k")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--figure", metavar="PNG")
    parser.add_argument("--times", action="store_true", help="times of the products of every focuser")
    args = parser.parse_args()
    if args.times:
        print_times()
        return
    clean, places = drawn_data(args.seed)
    rng = np.random.default_rng([args.seed, 1])
    shape = clean.data.shape
    noise = rng.standard_normal(shape) + 1j * rng.standard_normal(shape)
    # of a pulse's strongest sample
    level = float(np.sqrt(np.mean(np.abs(clean.data).max(axis=2) ** 2))) * 10.0 ** (-0.05 * SNR_DB)
    data = (clean.data + level * np.sqrt(0.5) * noise).astype(np.complex64)
    pulses = rng.permutation(shape[1]) < PRESENT * shape[1]
    present = np.broadcast_to(pulses[None, :, None], shape).astype(np.float32)
    operator = focusing_operator(
        clean, focuser=args.focuser, range_window="rectangular", azimuth_window="rectangular"
    )
    x, scale = sparse_pixels(operator, data.ravel(), present.ravel())
    filled = np.asarray(scale * (operator.H @ x)).reshape(shape)

    def image_of(values: C64) -> SarImage:
        return sarmitsuba.focus(replace(clean, data=values), focuser=args.focuser)

    truth = image_of(clean.data)
    images = {
        "all pulses": image_of(data),
        "a third of them": image_of((data * present / pulses.mean()).astype(np.complex64)),
        "sparse points of that third": image_of(filled.astype(np.complex64)),
    }
    print(
        f"{pulses.sum()} of {pulses.size} pulses, {np.count_nonzero(x)} of {x.size} pixels not zero, {args.focuser}"
    )
    print("| image | error against all pulses without noise, dB | highest away from points, dB of 1 m^2 |")
    print("|---|---|---|")
    for name, image in images.items():
        error = image_error_db(image.data[0], truth.data[0])
        print(f"| {name} | {error:.1f} | {highest_away(image, places):.1f} |")
    if args.figure:
        _plot(images, args.figure)


def _plot(images: dict[str, SarImage], path: str) -> None:
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(1, 3, figsize=(12, 4.2), sharey=True, layout="constrained")
    top = 20.0 * np.log10(np.abs(images["all pulses"].data).max())
    for axis, (name, image) in zip(axes, images.items(), strict=True):
        grid = image.grid
        extent = (grid.range[0], grid.range[-1], grid.azimuth[0], grid.azimuth[-1])
        shown = 20.0 * np.log10(np.maximum(np.abs(image.data[0]), 1e-12)) - top
        drawn = axis.imshow(
            shown, vmin=-50.0, vmax=0.0, extent=extent, origin="lower", cmap="inferno", aspect="auto"
        )
        axis.set(title=name, xlabel="ground range (m)")
    axes[0].set_ylabel("azimuth (m)")
    figure.colorbar(drawn, ax=axes, label="dB")
    figure.savefig(path, dpi=110)
    plt.close(figure)


if __name__ == "__main__":
    main()
