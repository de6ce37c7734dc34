"""Radar cross section of a target over aspect and bounce order, traced in the far field, and its image.

Azimuth 0 is +x (east), 90 is +y (north); elevation is counted from the horizontal.
"""

import argparse
import csv
import dataclasses
import hashlib
import math
import shlex
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from sarmitsuba.commands.console import Console
from sarmitsuba.commands.scene_arguments import add_scene_arguments, scene_of, scene_record
from sarmitsuba.core.constants import DEFAULT_WINDOW
from sarmitsuba.core.errors import DataError
from sarmitsuba.core.timing import StageTimer

if TYPE_CHECKING:
    from sarmitsuba.core.arrays import F64
    from sarmitsuba.machine.output import OutputFolder
    from sarmitsuba.scene.scene import Scene
    from sarmitsuba.signal.image import SarImage
    from sarmitsuba.simulation.execution.turntable import Aspects, RcsSweep

NAME = "rcs"
HELP = "radar cross section of a target over azimuth or elevation, and its image from the sweep"

TABLE, PLOT = "rcs.csv", "rcs.png"
# radar of a mesh without one: only its frequency is used
_RADAR = "airborne_x"
MOST_DIRECTIONS = 100_000
# Hz, and share of the carrier: bandwidth of the radar where --frequency is given
_BANDWIDTH, _BAND_SHARE = 300e6, 0.2


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this command's arguments."""
    from sarmitsuba.core.constants import BANDS

    add_scene_arguments(parser)
    parser.add_argument(
        "-o", "--output", metavar="OUT", help="folder for the results (default: rcs_ and the scene's name)"
    )
    parser.add_argument(
        "--azimuth",
        type=_angles,
        default="0:360:0.5",
        metavar="DEG|FIRST:LAST:STEP",
        help="azimuth of the radar seen from the target: 0 is +x (east), 90 is +y (north); both ends are included, "
        "but 360 is not traced again after 0; write --azimuth=-30:30:0.5 where it begins with a minus (default: "
        "0:360:0.5)",
    )
    parser.add_argument(
        "--elevation",
        type=_angles,
        default="30",
        metavar="DEG|FIRST:LAST:STEP",
        help="elevation of the radar above the horizontal; a sweep of it needs a single azimuth (default: 30)",
    )
    parser.add_argument(
        "--pol",
        default="HH,VV",
        metavar="LIST",
        help="HH, HV, VH, VV, RH, RV ..., transmit letter first (default: HH,VV)",
    )
    frequency = parser.add_mutually_exclusive_group()
    frequency.add_argument("--frequency", type=float, metavar="HZ", help="carrier (default: the scene's)")
    frequency.add_argument(
        "--band",
        choices=tuple(BANDS),
        help=f"carrier by its band: {', '.join(f'{k} {v / 1e9:g} GHz' for k, v in BANDS.items())}",
    )
    parser.add_argument(
        "--max-depth",
        type=int,
        metavar="N",
        help="largest number of bounces; 0 = automatic (default: the scene's)",
    )
    parser.add_argument(
        "--only",
        metavar="NAME",
        help='one object of the scene alone, such as a car; a pattern such as "car*" takes several together',
    )
    parser.add_argument("--seed", type=int, help="random seed of the rays (default: the scene's)")
    parser.add_argument("--no-image", action="store_true", help="make no image, which takes most of the time")
    parser.add_argument(
        "--bandwidth",
        type=float,
        metavar="HZ",
        help="bandwidth of the image (default: 48 range cells over the target, at most 0.4 of the carrier)",
    )
    parser.add_argument(
        "--window", default=DEFAULT_WINDOW, metavar="NAME", help="window of the image (default: taylor)"
    )
    parser.add_argument(
        "--page",
        action="store_true",
        help="also write a web page with the target in 3-D and its RCS",
    )
    parser.add_argument(
        "--force", action="store_true", help="replace results of something else in OUT; other files stay"
    )


def run(args: argparse.Namespace, console: Console) -> int:
    """Sweep."""
    from sarmitsuba.commands import results
    from sarmitsuba.commands.view import PAGE
    from sarmitsuba.loading.assemble import NO_CLUTTER
    from sarmitsuba.loading.collect import NO_GROUND
    from sarmitsuba.machine.output import output_folder
    from sarmitsuba.radar.polarisation import read_channels
    from sarmitsuba.signal.focusing.windows import parse_window
    from sarmitsuba.simulation.execution.turntable import image_refusal, rcs_sweep, undersampling

    aspects = _aspects(args)
    channels = read_channels(args.pol, "rcs")
    parse_window(args.window)
    _check_numbers(args)
    watch = StageTimer()
    with output_folder(args.output or f"rcs_{Path(args.scene).stem}") as folder:
        from sarmitsuba.machine.backend import ensure_backend

        with watch.stage("start"):
            backend = ensure_backend()
        with watch.stage("load"):
            scene = _scene(args, console)
        why = "--no-image" if args.no_image else image_refusal(aspects)
        names = [TABLE, PLOT, results.RECORD]
        if not why:
            names += [results.PICTURE, "image.h5", *(results.picture_name(channels, c) for c in channels)]
        if args.page:
            names.append(PAGE)
        run_hash = _run_hash(scene, args, aspects)
        folder.check(run_hash, names, force=args.force)
        for note in scene.notes:
            if NO_CLUTTER not in note and NO_GROUND not in note:  # a cross section misses neither
                console.note(note)
        with watch.stage("rcs"):
            sweep = rcs_sweep(scene, aspects, channels=channels, progress=console.progress)
        for note in sweep.notes:
            console.note(note)
        for text in undersampling(scene, aspects):
            console.warn(text)
        folder.clear(run_hash)
        record = _record(args, scene, sweep, folder) | {"versions": results.versions(), "backend": backend}
        _write(folder, scene, sweep, console)
        image = None
        if why:
            console.note(f"no image: {why}")
        else:
            image = _image(folder, scene, aspects, channels, args, console, watch, record)
        record["warnings"], record["notes"] = console.warnings, console.notes
        record["seconds"] = {**watch.seconds, "total": watch.total}
        results.save_record(folder, record)
        if args.page:
            _page(folder, scene, sweep, image, console)
        console.say(f"{folder.path / PLOT} ({watch.total:.1f} s)")
    return 0


def _angles(text: str) -> tuple[float, ...]:
    """One angle, or first:last:step with both ends, deg."""
    try:
        parts = [float(part) for part in text.split(":")]
    except ValueError:
        parts = []
    if not all(math.isfinite(part) for part in parts) or len(parts) not in (1, 3):
        raise argparse.ArgumentTypeError(f"{text!r} is neither an angle in degrees nor FIRST:LAST:STEP")
    if len(parts) == 1:
        return (parts[0],)
    first, last, step = parts
    if step <= 0.0 or last < first:
        raise argparse.ArgumentTypeError(f"{text!r}: LAST is below FIRST, or STEP is not above 0")
    if (last - first) / step >= MOST_DIRECTIONS:
        raise argparse.ArgumentTypeError(f"{text!r}: more than {MOST_DIRECTIONS} directions; widen STEP")
    n = math.floor((last - first) / step + 1e-9) + 1
    return tuple(first + i * step for i in range(n))


def _aspects(args: argparse.Namespace) -> "Aspects":
    """The directions of the sweep.

    Raises
    ------
    DataError
        Both angles are swept, or one is out of bounds.
    """
    import numpy as np

    from sarmitsuba.simulation.execution.turntable import Aspects

    azimuth, elevation = np.array(args.azimuth), np.array(args.elevation)
    if azimuth.size > 1 and elevation.size > 1:
        raise DataError("rcs: --azimuth and --elevation are both swept; give one of them a single angle")
    for name, values, bound in (("azimuth", azimuth, 360.0), ("elevation", elevation, 90.0)):
        outside = values[np.abs(values) > bound]
        if outside.size:
            raise DataError(f"rcs: --{name} {outside[0]:g} deg is outside -{bound:g} to {bound:g} deg")
    if np.ptp(azimuth) > 360.0 + 1e-9:
        raise DataError(f"rcs: --azimuth spans {np.ptp(azimuth):g} deg, more than the circle of 360 deg")
    if azimuth.size > 1 and np.ptp(azimuth) > 360.0 - 1e-9:
        azimuth = azimuth[:-1]  # the last is the first again
    azimuth, elevation = np.broadcast_arrays(azimuth, elevation)
    return Aspects(np.radians(azimuth), np.radians(elevation))


def _check_numbers(args: argparse.Namespace) -> None:
    """Raise a SceneError for an option outside the bounds that the parameter of the same meaning has in a scene."""
    from sarmitsuba.loading.tables import INTEGRATOR, SENSOR

    INTEGRATOR["max_depth"].check_option("--max-depth", args.max_depth, "rcs")
    INTEGRATOR["seed"].check_option("--seed", args.seed, "rcs")
    SENSOR["center_frequency"].check_option("--frequency", args.frequency, "rcs")
    SENSOR["bandwidth"].check_option("--bandwidth", args.bandwidth, "rcs")


def _scene(args: argparse.Namespace, console: Console) -> "Scene":
    """The scene at the frequency asked for; a mesh without a radar gets one."""
    from sarmitsuba.core.constants import BANDS
    from sarmitsuba.loading.from_mesh import is_mesh_file

    frequency = BANDS[args.band] if args.band else args.frequency
    if args.radar is None and is_mesh_file(Path(args.scene)):
        args.radar = _RADAR
        if not frequency:
            console.note(
                f"{args.scene}: a mesh file has no frequency; that of {_RADAR} is used, see --frequency"
            )
    if frequency:
        args.define = [
            *args.define,
            ("sar_antenna.center_frequency", f"{frequency!r}"),
            # no part of a cross section; the scene's own may be more than the carrier has room for
            ("sar_antenna.bandwidth", f"{min(_BANDWIDTH, _BAND_SHARE * frequency)!r}"),
        ]
    scene = scene_of(args)
    changes = {"max_depth": args.max_depth, "seed": args.seed}
    settings = dataclasses.replace(scene.settings, **{k: v for k, v in changes.items() if v is not None})
    scene = dataclasses.replace(scene, settings=settings)
    return scene if args.only is None else _pick_object(scene, args.only, console)


def _pick_object(scene: "Scene", name: str, console: Console) -> "Scene":
    """The scene of one object alone, named after it."""
    from sarmitsuba.analysis.label_classes import match_shapes, pick_shapes, shape_names

    fitting = match_shapes(scene, name)
    left = len(shape_names(scene)) - len(fitting)
    said = ", ".join(fitting[:3]) + (f" and {len(fitting) - 3} more" if len(fitting) > 3 else "")
    console.note(
        f"{scene.name}: {said} alone, without {left} other object{'s' * (left != 1)}; `depth {scene.name} --only "
        f"{shlex.quote(name)}` has its echoes in the scene"
    )
    return dataclasses.replace(pick_shapes(scene, name), name=f"{scene.name}, {name}")


def _run_hash(scene: "Scene", args: argparse.Namespace, aspects: "Aspects") -> str:
    """Run hash: everything that the results depend on."""
    from sarmitsuba.simulation.execution.fingerprint import fingerprint

    angles = hashlib.sha256(aspects.directions.tobytes()).hexdigest()
    asked = (args.pol, args.bandwidth, args.window, args.no_image)
    return f"{fingerprint(scene, getattr(args, 'extension', ()))} rcs {asked} {angles}"


def _record(
    args: argparse.Namespace, scene: "Scene", sweep: "RcsSweep", folder: "OutputFolder"
) -> dict[str, object]:
    return {
        "command": "rcs",
        **scene_record(args, scene, folder.path),
        "center_frequency_hz": sweep.frequency,
        "azimuth_deg": [float(args.azimuth[0]), float(args.azimuth[-1])],
        "elevation_deg": [float(args.elevation[0]), float(args.elevation[-1])],
        "directions": int(sweep.aspects.azimuth.size),
        "channels": sweep.result.channels,
        "max_depth": sweep.max_depth,
        "orders": sweep.orders,
        "rays_per_direction": sweep.result.rays_per_direction,
        "ray_spacing_m": sweep.result.ray_spacing,
        "sampling_error_db": dict(zip(sweep.result.channels, sweep.error_db, strict=True)),
        "error": sweep.statement.as_dict(sweep.result.channels),
        "witnesses": {} if sweep.currents is None else {"currents": sweep.currents.witness.as_dict()},
    }


def _write(folder: "OutputFolder", scene: "Scene", sweep: "RcsSweep", console: Console) -> None:
    """Write the table and the plot, and print the strongest and mean RCS with the sampling error."""
    import numpy as np

    from sarmitsuba.commands.results import draw_into
    from sarmitsuba.core.units import db_from_power, power_from_db
    from sarmitsuba.machine.atomic import atomic_path
    from sarmitsuba.view.polar import AspectCurves, aspect_figure

    table = table_of(sweep)
    with (
        folder.writing(TABLE) as path,
        atomic_path(path) as part,
        part.open("w", newline="", encoding="utf-8") as file,
    ):
        writer = csv.writer(file)
        writer.writerow(table)
        writer.writerows(zip(*(_texts(name, column) for name, column in table.items()), strict=True))
    angle, swept, fixed = table["azimuth_deg"], "azimuth", f"elevation {table['elevation_deg'][0]:g} deg"
    if not sweep.aspects.by_azimuth and angle.size > 1:
        angle, swept, fixed = table["elevation_deg"], "elevation", f"azimuth {table['azimuth_deg'][0]:g} deg"
    curves, kind = [], "sampling" if sweep.currents is None else "mesh"
    for channel, error in zip(sweep.result.channels, sweep.error_db, strict=True):
        total = sweep.dbsm(channel)
        best = int(np.argmax(total))
        console.say(
            f"{channel}: strongest {total[best]:.2f} dBsm at {swept} {angle[best]:g} deg, mean "
            f"{db_from_power(max(float(np.mean(power_from_db(total))), 1e-300)):.2f} dBsm; {kind} error {error:.1f} dB"
        )
        parts = {f"{n} bounce{'s' if n > 1 else ''}": sweep.dbsm(channel, n) for n in sweep.orders}
        parts = parts if len(parts) > 1 else {}
        if sweep.currents is None:
            curves.append(AspectCurves(channel, total, parts))
        else:
            parts = {"ray optics": sweep.ray_optics_dbsm(channel)} | parts
            curves.append(AspectCurves(channel, total, parts, "solved currents"))
    console.say(sweep.statement.text)
    title = f"{scene.name},  {sweep.frequency / 1e9:.4g} GHz,  {fixed}"
    note = sweep.statement.text
    draw_into(
        folder, PLOT, lambda: aspect_figure(angle, curves, swept=swept, title=title, note=note), console
    )


def table_of(sweep: "RcsSweep") -> dict[str, "F64"]:
    """Columns of the table by name: angles, RCS and phase of every channel, RCS of its bounce orders."""
    import numpy as np

    aspects, result = sweep.aspects, sweep.result
    columns: dict[str, F64] = {
        "azimuth_deg": np.asarray(np.degrees(aspects.azimuth), dtype=np.float64),
        "elevation_deg": np.asarray(np.degrees(aspects.elevation), dtype=np.float64),
    }
    for i, channel in enumerate(result.channels):
        columns[f"{channel}_dbsm"] = sweep.dbsm(channel)
        columns[f"{channel}_phase_deg"] = np.degrees(np.angle(sweep.total[:, i]))
        if sweep.currents is not None:
            columns[f"{channel}_ray_optics_dbsm"] = sweep.ray_optics_dbsm(channel)
    for channel in result.channels:
        columns |= {f"{channel}_order_{n}_dbsm": sweep.dbsm(channel, n) for n in sweep.orders}
    return columns


def _texts(name: str, column: "F64") -> list[str]:
    return [
        f"{value:.9g}" if name in ("azimuth_deg", "elevation_deg") else f"{value:.4f}" for value in column
    ]


def _image(
    folder: "OutputFolder",
    scene: "Scene",
    aspects: "Aspects",
    channels: tuple[str, ...],
    args: argparse.Namespace,
    console: Console,
    watch: StageTimer,
    record: dict[str, object],
) -> "SarImage":
    """Render the image of the target from its aspects, write it with its pictures, and return it."""
    from sarmitsuba.commands import results
    from sarmitsuba.files import write_image
    from sarmitsuba.simulation.execution.render import render
    from sarmitsuba.simulation.execution.run import Run
    from sarmitsuba.simulation.execution.turntable import turntable_scene
    from sarmitsuba.view.display import TURNTABLE, PictureOptions
    from sarmitsuba.view.quicklook import quicklook

    table = turntable_scene(scene, aspects, channels=channels, bandwidth=args.bandwidth or 0.0)

    def ready(run: Run) -> None:
        needs = run.needs()
        console.say(str(needs))
        console.expect(needs.by_progress)

    with watch.stage("image"):
        image = render(
            table,
            range_window=args.window,
            azimuth_window=_azimuth_window(aspects, args.window),
            error_bars=False,  # the sweep has a statement of its own
            progress=console.progress,
            ready=ready,
        )
    image = dataclasses.replace(
        image,
        metadata={"scene": scene.name, "look_side": table.radar.look_side, TURNTABLE: True, **image.metadata},
    )
    with folder.writing("image.h5") as path:
        write_image(image, path, format="hdf5")
    for channel in channels:
        shown = partial(quicklook, image, PictureOptions(channel=channel, quantity="rcs"))
        results.draw_into(folder, results.picture_name(channels, channel), shown, console)
    record["image"] = {
        "radar": results.radar_record(table.radar),
        "image_request": table.image.as_dict(),
        "plan": image.metadata.get("plan"),
    }
    wave = table.radar.waveform
    console.say(
        f"{folder.path / results.PICTURE}: image of the target on a turntable, {wave.center_frequency / 1e9:.4g} GHz, "
        f"bandwidth {wave.bandwidth / 1e6:.4g} MHz, {'/'.join(channels)}, {table.radar.track.n_pulses} aspects"
    )
    return image


def _page(
    folder: "OutputFolder", scene: "Scene", sweep: "RcsSweep", image: "SarImage | None", console: Console
) -> None:
    """Write the page."""
    from sarmitsuba.commands.view import PAGE
    from sarmitsuba.view.page import payload as rcs_payload
    from sarmitsuba.view.page.write import write_page

    with folder.writing(PAGE) as path:
        write_page(path, rcs_payload.rcs_payload(scene, sweep, image), rcs_payload.PAGE)
    size = (folder.path / PAGE).stat().st_size
    console.say(f"{folder.path / PAGE} ({size / 1e6:.1f} MB; open it in a browser)")


def _azimuth_window(aspects: "Aspects", window: str) -> str:
    """Azimuth window; None over a whole circle, whose aperture has no ends."""
    return "rectangular" if aspects.whole_circle else window
