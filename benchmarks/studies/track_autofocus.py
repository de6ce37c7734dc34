"""Errors of the antenna's track: autofocus, which knows no scene, against the fit of the track to a known scene.

    python -m benchmarks.studies.track_autofocus --first 400 -o out/track_autofocus
    python -m benchmarks.studies.track_autofocus --gotcha FILE_OR_FOLDER --targets targets.csv -o out/gotcha

Knots of the track are drawn up to a quarter of a wavelength, and up to two, along every axis, linear between them, 30
dB of signal over noise. Images are made on the recorded track, after each autofocuser, on the fitted track and on the
true one. Scenes: metal trihedrals on clutter, of which the fit knows the trihedrals alone (``points``); the same over
an aperture of 15 degrees (``wide``) and with range cells of 7.5 cm, so that errors cross cells (``fine range``); fields
with a box without bright points, of which the fit knows also the speckle (``fields``).

Range errors that a displacement of the whole scene in its plane makes do not blur an image, and autofocus leaves them.
Errors are stated without them, and images are compared in place; what is left of them is printed as ``shift``.

``--gotcha`` takes phase histories that the user has, and a table of known corner reflectors, one a line: x, y, z of the
corner, m, the edge, m, and the azimuth of the open side, degrees from x to y. Knots of the track and the gain are
fitted; printed are the range error beside that of the provider's records, and contrast and entropy of the images.
"""

import argparse
import json
import time
import warnings
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from sarmitsuba import fit
from sarmitsuba.analysis.image_quality import contrast, entropy
from sarmitsuba.core.arrays import F64
from sarmitsuba.files import read_raw
from sarmitsuba.radar.radar import Radar
from sarmitsuba.signal.focusing import AUTOFOCUSERS, default_grid
from sarmitsuba.signal.focusing.autofocus import AutofocusTask, correct_ranges
from sarmitsuba.signal.focusing.focuser import parse_focuser
from sarmitsuba.signal.focusing.windows import parse_window
from sarmitsuba.signal.image import ImageGrid, SarImage
from sarmitsuba.signal.raw_data import RawData
from tests.support.fits import fields
from tests.support.recorded_tracks import fitted_to_targets, read_targets
from tests.support.tracks import TrackCase, targets, track_case, track_offsets
from tests.support.unweighted import focus

KNOTS, SNR_DB = 6, 30.0
# largest displacements along every axis, wavelengths
ERRORS = (0.25, 2.0)
# clutter that a fit does not know, sigma0 at normal incidence, and what it takes in its place, dB
CLUTTER, WITHOUT = -10.0, -60.0
SHAPES: dict[str, dict[str, Any]] = {
    "points": {"extent": 20.0, "bandwidth": 300e6, "azimuth_resolution": 0.4, "pulses": 192},
    "wide": {"extent": 6.0, "bandwidth": 600e6, "azimuth_resolution": 0.06, "pulses": 256},
    "fine range": {"extent": 6.0, "bandwidth": 2e9, "azimuth_resolution": 0.1, "pulses": 160},
}
SCENES = (*SHAPES, "fields")
FIELD_PULSES = 192
METHODS = ("recorded", *AUTOFOCUSERS.names, "fit", "true")


def case(scene: str, wavelengths: float, seed: int) -> TrackCase:
    """Drawn data of a kind of scene."""
    if scene == "fields":
        return track_case(fields(seed, 4, FIELD_PULSES), KNOTS, wavelengths, seed, SNR_DB)
    known, real = (targets(seed, level_db=level, **SHAPES[scene]) for level in (WITHOUT, CLUTTER))
    return track_case(known, KNOTS, wavelengths, seed, SNR_DB, real)


def estimate(name: str, raw: RawData, grid: ImageGrid) -> F64:
    """Range error of every pulse by an autofocuser, m."""
    window = parse_window("rectangular")
    task = AutofocusTask(raw, grid, parse_focuser("backprojection"), window, window)
    return AUTOFOCUSERS[name].estimate(task)


def displaced(radar: Radar, error: F64) -> tuple[F64, F64]:
    """Range error (n_pulses,), m, without the part that a displacement (x, y), m, of the scene makes, and that."""
    sight = radar.track.position - radar.aim_point
    plane = sight[:, :2] / np.linalg.norm(sight, axis=1, keepdims=True)
    place = np.linalg.lstsq(plane, error, rcond=None)[0]
    return np.asarray(error - plane @ place), np.asarray(-place)


def blurring(radar: Radar, error: F64) -> F64:
    """Range error (n_pulses,), m, without the part that a displacement of the scene in its plane makes."""
    return displaced(radar, error)[0]


def compared(one: TrackCase) -> tuple[dict[str, dict[str, float]], dict[str, SarImage]]:
    """Figures and images of all methods."""
    radar, wavelength = one.raw.radar, one.raw.radar.waveform.wavelength
    error = one.along_sight(one.flown)
    right = one.on_track(one.flown)
    grid = default_grid(right)
    true = focus(right, grid)
    images, figures = {"true": true}, {}
    for name in METHODS[:-1]:
        begun = time.process_time()
        if name == "fit":
            found = fit(one.scene, one.raw, f"track:{KNOTS}")
            offsets = track_offsets(one.scene, KNOTS, found.values)
            seconds = time.process_time() - begun
            left = one.along_sight(one.flown - offsets)
            blur = blurring(radar, left)
            images[name] = focus(one.on_track(offsets), grid)
        else:
            known = np.zeros_like(error) if name == "recorded" else estimate(name, one.raw, grid)
            seconds = time.process_time() - begun
            left = error - known
            blur = blurring(radar, left)
            # in place: with the shift that autofocus does not see
            images[name] = focus(correct_ranges(one.raw, error - blur), grid)
        figures[name] = {
            "blur": float(np.abs(blur).max() / wavelength),
            "blur_rms": float(np.sqrt(np.mean(blur**2)) / wavelength),
            "shift": float(np.abs(left - blur).max() / wavelength),
            "seconds": seconds,
        }
    figures["true"] = dict.fromkeys(("blur", "blur_rms", "shift", "seconds"), 0.0)
    for name, image in images.items():
        a, b = image.data[0].ravel(), true.data[0].ravel()
        like = abs(np.vdot(a, b)) ** 2 / float(np.vdot(a, a).real * np.vdot(b, b).real)
        figures[name] |= {
            "peak_db": float(20.0 * np.log10(np.abs(a).max() / np.abs(b).max())),
            "contrast": float(contrast(image.rcs())),
            "entropy": float(entropy(image.rcs())),
            # power of what is not a multiple of the true image
            "unlike_db": float(10.0 * np.log10(max(1.0 - like, 1e-8))),
        }
    return figures, images


def drawn(seeds: Sequence[int], scenes: Sequence[str], output: Path) -> list[dict[str, object]]:
    """Print the table of the drawn scenes; draw the images of the first."""
    print(
        f"{'scene':11}{'error':>6} {'method':17}{'left, wavelengths':>26}{'shift':>8}{'peak':>7}{'contrast':>9}"
        f"{'entropy':>8}{'unlike':>8}{'CPU':>6}\n{'':35}{'median of largest, worst':>26}{'':8}{'dB':>7}{'':>9}"
        f"{'nats':>8}{'dB':>8}{'s':>6}"
    )
    lines: list[dict[str, object]] = []
    for scene in scenes:
        for wavelengths in ERRORS:
            found = []
            for seed in seeds:
                figures, images = compared(case(scene, wavelengths, seed))
                found.append(figures)
                if seed == seeds[0]:
                    name = f"{scene.replace(' ', '_')}_{wavelengths:g}.png"
                    titles = {
                        one: f"{one.replace('_', ' ')}: {figures[one]['blur']:.3g} wavelengths left"
                        for one in ("recorded", "phase_gradient", "fit")
                    }
                    picture(
                        output / name,
                        images,
                        titles | {"true": "true"},
                        f"{scene}, knots off by up to {wavelengths:g} wavelengths",
                    )
            for method in METHODS:
                of = {key: [one[method][key] for one in found] for key in found[0][method]}
                line = {key: float(np.median(values)) for key, values in of.items()}
                worst = max(of["blur"])
                print(
                    f"{scene:11}{wavelengths:6.2f} {method:17}{line['blur']:16.4f}{worst:10.4f}{line['shift']:8.3f}"
                    f"{line['peak_db']:7.2f}{line['contrast']:9.2f}{line['entropy']:8.2f}{line['unlike_db']:8.1f}"
                    f"{line['seconds']:6.1f}",
                    flush=True,
                )
                lines.append({"scene": scene, "error": wavelengths, "method": method, "worst": worst, **line})
    return lines


def picture(path: Path, images: dict[str, SarImage], titles: dict[str, str], title: str) -> None:
    """Images by name, with the same grey levels: those of the last one."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(4.0 * len(titles), 4.6), dpi=90, layout="constrained")
    top = 10.0 * np.log10(images[list(titles)[-1]].rcs().max())
    for axes, (name, text) in zip(figure.subplots(1, len(titles)), titles.items(), strict=True):
        grid = images[name].grid
        level = 10.0 * np.log10(np.maximum(images[name].rcs(), 10 ** (0.1 * top - 6.0)))
        extent = (grid.range[0], grid.range[-1], grid.azimuth[0], grid.azimuth[-1])
        axes.imshow(
            level, origin="lower", extent=extent, cmap="gray", vmin=top - 45.0, vmax=top, aspect="auto"
        )
        axes.set_title(text, fontsize=9)
        axes.set_xlabel(f"{grid.kind} range (m)")
        axes.ticklabel_format(useOffset=False)
        axes.locator_params(nbins=5)
    figure.axes[0].set_ylabel("azimuth (m)")
    figure.suptitle(title, fontsize=10)
    figure.savefig(path)


def only_first(raw: RawData) -> RawData:
    """Data of the first channel alone."""
    return replace(raw, data=raw.data[:1], layers=raw.layers[:1], autofocus_records={})


def measured(
    path: Path, table: Path, knots: int, extent: float, wavelengths: float, seed: int, output: Path
) -> dict[str, object]:
    """Fit the track of phase histories to known corner reflectors; print it beside the provider's records.

    Range errors linear between knots, of up to so many wavelengths, are put into the data before, if any.
    """
    raw = read_raw(path)
    radar, wavelength = raw.radar, raw.radar.waveform.wavelength
    at = np.linspace(0.0, 1.0, knots)
    drawn_at = np.random.default_rng([seed, 0x607]).uniform(-1.0, 1.0, knots) * wavelengths * wavelength
    put_in = np.interp(np.linspace(0.0, 1.0, radar.track.n_pulses), at, drawn_at)
    raw = correct_ranges(raw, -put_in)
    begun = time.process_time()
    found = fitted_to_targets(raw, read_targets(table), knots)
    seconds, converged = time.process_time() - begun, "" if found.fit.converged else "not "
    print(f"{radar.track.n_pulses} pulses, {knots} knots: fit {converged}converged in {seconds:.0f} CPU s")
    request = {"extent_azimuth": extent, "extent_range": extent} if extent else None
    channel = raw.channels[0]
    errors: dict[str, Callable[[], F64]] = {
        "recorded": lambda: np.zeros(radar.track.n_pulses),
        "phase_gradient": lambda: estimate("phase_gradient", only_first(raw), default_grid(raw, request)),
        "fit": lambda: found.range_error,
    }
    records = raw.autofocus_records.get(channel)
    if records is not None:
        errors["records"] = lambda: put_in + records.range_error(wavelength)
    whole = {name: error() for name, error in errors.items()}
    known = {name: displaced(radar, error) for name, error in whole.items()}
    # all images in one place, so that they show the same scene
    in_place = "fit" if records is None else "records"
    moved = whole[in_place] - known[in_place][0]
    lines: dict[str, object] = {}
    images, titles = {}, {}
    for name, (error, place) in known.items():
        images[name] = focus(correct_ranges(raw, error + moved), request=request)
        power = images[name].rcs()
        line: dict[str, object] = {
            "place_m": place.tolist(),
            "range_error_rms_m": float(error.std()),
            "contrast": float(contrast(power)),
            "entropy": float(entropy(power)),
        }
        titles[name], note = f"{name.replace('_', ' ')}: contrast {line['contrast']:.1f}", ""
        if "records" in known and name != "records":
            off = float((error - known["records"][0]).std())
            line["off_records_rms_m"] = off
            note = f"off the records by {1e3 * off:.2f} mm rms, {off / wavelength:.3f} wavelengths"
        print(
            f"{name:15} scene moved by ({place[0]:6.3f}, {place[1]:6.3f}) m, "
            f"beyond it {1e3 * error.std():6.2f} mm rms   "
            f"contrast {line['contrast']:6.2f}   entropy {line['entropy']:7.3f} nats   {note}"
        )
        lines[name] = line
    text = f", range errors of up to {wavelengths:g} wavelengths put in" if wavelengths else ""
    picture(output / "measured.png", images, titles, f"measured data, {knots} knots{text}")
    return lines


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--first", type=int, default=400, help="first seed")
    parser.add_argument("--count", type=int, default=3, help="drawn cases of each row")
    parser.add_argument("--scenes", nargs="+", choices=SCENES, default=SCENES)
    parser.add_argument(
        "--gotcha", type=Path, help="file or folder of phase histories in the layout of the Gotcha set"
    )
    parser.add_argument("--targets", type=Path, help="table of the known corner reflectors, with --gotcha")
    parser.add_argument("--knots", type=int, default=8, help="of the track, with --gotcha")
    parser.add_argument(
        "--error",
        type=float,
        default=0.0,
        help="wavelengths, with --gotcha: knots drawn by --first of a range error that is put into the data",
    )
    parser.add_argument(
        "--extent", type=float, default=0.0, help="of the image, m, with --gotcha; default: the data's"
    )
    parser.add_argument("-o", "--output", type=Path, default=Path("out/track_autofocus"))
    args = parser.parse_args()
    if (args.gotcha is None) != (args.targets is None):
        parser.error("--gotcha and --targets go together")
    warnings.simplefilter("ignore")
    args.output.mkdir(parents=True, exist_ok=True)
    if args.gotcha is not None:
        record: object = measured(
            args.gotcha, args.targets, args.knots, args.extent, args.error, args.first, args.output
        )
    else:
        record = drawn(range(args.first, args.first + args.count), args.scenes, args.output)
    (args.output / "track_autofocus.json").write_text(json.dumps(record, indent=1), encoding="utf-8")


if __name__ == "__main__":
    main()
