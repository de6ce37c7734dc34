"""What physics a learner needs: accuracy on hybrid images of a classifier and a detector trained on simpler ones.

Usage: python -m benchmarks.studies.learner_physics [--train N] [--test N] [--seeds N] [--first SEED]
       [--rows TEXT ...] [--keep FOLDER]

Data sets of the ten shipped vehicle-like and boat-like bodies are drawn by ``sarmitsuba dataset``: any aspect, three
grounds, two looks, up to three boxes beside the body, 128 x 128 pixels. All tests are on chips of method hybrid with
all bounces, drawn with other seeds than those for training. Rows differ in what the training chips are: their method,
number of bounces, aspects (headings every so many degrees), resolution (of both).

- **Classifier**: which of ten bodies. Means of power over 1 m x 1 m of the middle 24 m x 24 m, in dB less their mean,
  then linear discriminant analysis on the strongest 60 principal components, with pooled covariance shrunk by a tenth.
- **Neighbours**: a second learner of another kind, the most frequent body of the nearest chips for training, by the
  distance in the same components.
- **Detector**: where the body is. Areas of 1 m cells above a threshold over the chip's median; the threshold is the
  one of the best F1 on the training chips. A detection counts where its strongest cell lies within 2 m of the body's
  box; more than one on a body, and those elsewhere (boxes!), are false.

Accuracies have a standard error of half the square root of 1 / N at most: 2.5 % for 400 chips.
"""

import argparse
import subprocess
import sys
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import h5py
import numpy as np
import scipy
from numpy.typing import NDArray

F64 = NDArray[np.float64]

RECIPE = """
[dataset]
samples = {samples}
seed = {seed}
[parts]
by = "scene"
[images]
pixels_azimuth = {pixels}
pixels_range = {pixels}
[objects]
meshes = "targets"
heading_deg = {heading}
spread = 4.0
[ground]
material = {{ choice = ["soil", "grass", "asphalt"] }}
[clutter]
count = {{ uniform = [0, 3] }}
spread = 24.0
heading_deg = {{ uniform = [0, 180] }}
[radar]
slant_range = 8000.0
look_angle_deg = {{ choice = [40.0, 55.0] }}
bandwidth = {bandwidth}
azimuth_resolution = {resolution}
[film]
pixel_spacing_azimuth = {spacing}
pixel_spacing_range = {spacing}
[tracing]
method = "{method}"
ray_spacing = 0.05
max_depth = {depth}
"""
CELL, KEPT, SHRINK, NEAR = 1.0, 24, 0.1, 2.0
COMPONENTS = 60
NEIGHBOURS = 5
THRESHOLDS = 10.0 ** np.arange(0.3, 3.0, 0.1)


@dataclass(frozen=True)
class Drawn:
    """What a set of chips is drawn with.

    Parameters
    ----------
    method, depth : of the simulation; depth 0: automatic
    step_deg : headings in steps; 0: any
    coarser : factor on the resolution of 0.4 m
    """

    method: str = "hybrid"
    depth: int = 0
    step_deg: float = 0.0
    coarser: int = 1

    def recipe(self, samples: int, seed: int) -> str:
        headings = ", ".join(f"{h:.1f}" for h in np.arange(0.0, 360.0, self.step_deg or 360.0))
        return RECIPE.format(
            samples=samples,
            seed=seed,
            pixels=128 // self.coarser,
            heading=f"{{ choice = [{headings}] }}" if self.step_deg else "{ uniform = [0, 360] }",
            bandwidth=400e6 / self.coarser,
            resolution=0.4 * self.coarser,
            spacing=0.25 * self.coarser,
            method=self.method,
            depth=self.depth,
        )


@dataclass(frozen=True, eq=False)
class Chips:
    """Chips as a learner sees them.

    Parameters
    ----------
    power : (n, rows, columns) means over cells of 1 m
    body : (n,) name of the mesh
    box : (n, 4) first and last row and column of the body's vertices, m from the corner of the first pixel
    """

    power: F64
    body: NDArray[np.str_]
    box: F64


def make(folder: Path, drawn: Drawn, samples: int, seed: int) -> Chips:
    """Chips of a drawn data set, made by the command unless they are there."""
    name = f"{drawn.method}_{drawn.depth}_{drawn.step_deg:.0f}_{drawn.coarser}_{seed}_{samples}"
    path = folder / f"{name}.toml"
    path.write_text(drawn.recipe(samples, seed), encoding="utf-8")
    command = [sys.executable, "-m", "sarmitsuba", "dataset", str(path), "-o", str(folder / name), "--quiet"]
    if not (folder / name / "dataset.h5").is_file():
        subprocess.run(command, check=True)
    spacing = 0.25 * drawn.coarser
    cell = round(CELL / spacing)
    with h5py.File(folder / name / "dataset.h5") as file:
        image = file["images"][:, 0]
        body = np.array([one.decode() for one in file["rows/target_instance"][()]])
        row, instance = file["objects/row"][()], file["objects/instance"][()]
        target = np.flatnonzero([bool(one) for one in instance])
        box = np.zeros((len(image), 4))
        box[row[target]] = (file["objects/box"][()][target] + 0.5) * spacing
    power = np.square(np.abs(image.astype(np.complex128)))
    n, rows, columns = power.shape
    cells = power.reshape(n, rows // cell, cell, columns // cell, cell).mean(axis=(2, 4))
    return Chips(cells, body, box)


def features(chips: Chips) -> F64:
    """Levels (n, cells) in dB about their mean."""
    edge = (chips.power.shape[1] - KEPT) // 2
    kept = chips.power[:, edge : edge + KEPT, edge : edge + KEPT].reshape(len(chips.power), -1)
    level = 10.0 * np.log10(kept + 1e-6 * kept.mean(axis=1, keepdims=True))
    return np.asarray(level - level.mean(axis=1, keepdims=True))


def components(train: Chips, test: Chips) -> tuple[F64, F64]:
    """Strongest principal components of the levels of the training chips, of both sets."""
    x, y = features(train), features(test)
    mean = x.mean(axis=0)
    _, _, axes = np.linalg.svd(x - mean, full_matrices=False)
    axes = axes[:COMPONENTS]
    return (x - mean) @ axes.T, (y - mean) @ axes.T


def neighbour_accuracy(train: Chips, test: Chips) -> float:
    """Share of test chips whose body is the most frequent one of the nearest training chips, the nearest of equals."""
    x, y = components(train, test)
    nearest = scipy.spatial.cKDTree(x).query(y, k=NEIGHBOURS)[1]
    right = 0
    for of, truth in zip(train.body[nearest], test.body, strict=True):
        names, first, count = np.unique(of, return_index=True, return_counts=True)
        right += names[np.lexsort((first, -count))[0]] == truth
    return right / len(test.body)


def classifier_accuracy(train: Chips, test: Chips) -> float:
    """Share of test chips whose body linear discriminant analysis names."""
    x, y = components(train, test)
    names = np.unique(train.body)
    centres = np.stack([x[train.body == name].mean(axis=0) for name in names])
    within = x - centres[np.searchsorted(names, train.body)]
    spread = within.T @ within / max(1, len(x) - len(names))
    spread = (1.0 - SHRINK) * spread + SHRINK * np.trace(spread) / len(spread) * np.eye(len(spread))
    weights = np.linalg.solve(spread, centres.T)
    score = y @ weights - 0.5 * np.einsum("ci,ic->c", centres, weights)
    return float(np.mean(names[score.argmax(axis=1)] == test.body))


def detections(chips: Chips, threshold: float) -> tuple[int, int]:
    """Bodies found, and false detections, over the median by a factor."""
    hits = wrong = 0
    for power, box in zip(chips.power, chips.box, strict=True):
        areas, count = scipy.ndimage.label(power > threshold * np.median(power), np.ones((3, 3)))
        peaks = scipy.ndimage.maximum_position(power, areas, np.arange(1, count + 1)) if count else []
        at = (np.array(peaks, dtype=np.float64).reshape(-1, 2) + 0.5) * CELL
        inside = np.all((at >= box[:2] - NEAR) & (at <= box[2:] + NEAR), axis=1)
        hits += bool(inside.any())
        wrong += count - bool(inside.any())
    return hits, wrong


def detector_f1(train: Chips, test: Chips) -> tuple[float, float, float]:
    """F1 on test chips, with the threshold of the best F1 on the training chips; recall, false detections a chip."""

    def f1(chips: Chips, threshold: float) -> float:
        hits, wrong = detections(chips, threshold)
        return 2.0 * hits / (hits + wrong + len(chips.power))

    best = max(THRESHOLDS, key=lambda t: f1(train, float(t)))
    hits, wrong = detections(test, float(best))
    return f1(test, float(best)), hits / len(test.power), wrong / len(test.power)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--train", type=int, default=500, help="chips for training")
    parser.add_argument("--test", type=int, default=400, help="chips for tests")
    parser.add_argument("--seeds", type=int, default=1, help="draws of the training chips")
    parser.add_argument(
        "--first", type=int, default=2000, help="seed of the first draw of the training chips"
    )
    parser.add_argument(
        "--rows", nargs="+", default=[""], help="rows whose names hold one of these texts alone"
    )
    parser.add_argument("--keep", type=Path, help="folder for the data sets, read again where they are there")
    args = parser.parse_args()
    rows: Mapping[str, tuple[Drawn, Drawn]] = {
        "raster": (Drawn("raster"), Drawn()),
        "image, 1 bounce": (Drawn("image", 1), Drawn()),
        "image, 2 bounces": (Drawn("image", 2), Drawn()),
        "image, all bounces": (Drawn("image"), Drawn()),
        "hybrid, 1 bounce": (Drawn("hybrid", 1), Drawn()),
        "hybrid, all bounces": (Drawn(), Drawn()),
        "image, aspects every 30 deg": (Drawn("image", step_deg=30.0), Drawn()),
        "image, aspects every 60 deg": (Drawn("image", step_deg=60.0), Drawn()),
        "image, aspects every 120 deg": (Drawn("image", step_deg=120.0), Drawn()),
        "image, all bounces, 0.8 m": (Drawn("image", coarser=2), Drawn(coarser=2)),
        "image, all bounces, 1.6 m": (Drawn("image", coarser=4), Drawn(coarser=4)),
    }
    with tempfile.TemporaryDirectory() as temporary:
        folder = args.keep or Path(temporary)
        folder.mkdir(parents=True, exist_ok=True)
        print(
            f"train {args.train}, test {args.test} chips, {args.seeds} draw(s) of the training chips from seed "
            f"{args.first}"
        )
        print(
            "| training chips | classifier, % right | neighbours, % right | detector, F1 | recall | false a chip |\n"
            "|---|---|---|---|---|---|"
        )
        for name, (drawn, tested) in rows.items():
            if not any(text in name for text in args.rows):
                continue
            test = make(folder, tested, args.test, 1000)
            found = []
            for seed in range(args.seeds):
                train = make(folder, drawn, args.train, args.first + seed)
                right = [100.0 * one(train, test) for one in (classifier_accuracy, neighbour_accuracy)]
                found.append((*right, *detector_f1(train, test)))
            linear, nearest, f1, recall, false = np.mean(found, axis=0)
            print(
                f"| {name} | {linear:.1f} | {nearest:.1f} | {f1:.2f} | {recall:.2f} | {false:.2f} |",
                flush=True,
            )


if __name__ == "__main__":
    main()
