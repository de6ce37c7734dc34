"""Show the contribution of each bounce to the image of a scene, and its cost: table, chart, pictures by depth."""

import argparse
import json
from contextlib import nullcontext
from functools import partial
from typing import TYPE_CHECKING

from sarmitsuba.commands.console import Console
from sarmitsuba.commands.scene_arguments import add_scene_arguments, scene_of

if TYPE_CHECKING:
    from sarmitsuba.apps.depth import DepthStudy
    from sarmitsuba.machine.output import OutputFolder
    from sarmitsuba.scene.scene import Scene
    from sarmitsuba.view.figure import Figure

NAME = "depth"
HELP = "show error, energy and time of a scene's image by number of bounces"

RECORD, CHART, PICTURES, ORDERS = "depth.json", "depth.png", "depth_images.png", "depth_orders.png"
# depths of the pictures, and the span of their grey levels, dB
SHOWN, SPAN_DB = 4, 50.0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this command's arguments."""
    add_scene_arguments(parser)
    parser.add_argument(
        "--deepest", type=int, default=6, metavar="N", help="bounces of the reference image (default: 6)"
    )
    parser.add_argument(
        "--only",
        metavar="NAME",
        help="instead: the radar cross section of one object, such as a building, by mechanism and bounces; a pattern "
        'such as "house*" takes several together',
    )
    parser.add_argument("--channel", metavar="NAME", help="polarisation, such as VV (default: the first)")
    parser.add_argument(
        "--no-times", action="store_true", help="leave out the runs of each depth that measure its seconds"
    )
    parser.add_argument(
        "-o", "--output", metavar="OUT", help=f"folder for {RECORD}, {CHART}, {PICTURES} and {ORDERS}"
    )
    parser.add_argument("--json", action="store_true", help="print as JSON")


def run(args: argparse.Namespace, console: Console) -> int:
    """Run the depths, print the table, draw the pictures."""
    from sarmitsuba.core.errors import SceneError
    from sarmitsuba.machine.output import output_folder

    if not 2 <= args.deepest <= 64:
        raise SceneError(f"depth: --deepest = {args.deepest} must be between 2 and 64")
    from sarmitsuba.apps.depth import study_depth

    with output_folder(args.output) if args.output else nullcontext() as folder:
        if folder is not None:
            folder.check_names((RECORD, CHART, PICTURES, ORDERS))
        scene = scene_of(args)
        if args.only is not None:
            return _print_object(scene, args, folder, console)
        console.expect({"depth": 1.0}, at_most=True)
        study = study_depth(
            scene,
            deepest=args.deepest,
            channel=args.channel,
            timed=not args.no_times,
            progress=console.progress,
        )
        console.end_progress()
        rows = list_rows(study)
        console.say(json.dumps(rows, indent=2) if args.json else format_table(study))
        if folder is not None:
            _save(folder, study, rows, console)
    return 0


def _print_object(
    scene: "Scene", args: argparse.Namespace, folder: "OutputFolder | None", console: Console
) -> int:
    """Print the backscatter of one object by mechanism."""
    from math import log10

    from sarmitsuba.analysis.echo_labels import object_echoes
    from sarmitsuba.machine import output as parameter_file

    echoes = object_echoes(scene, args.only, args.channel)
    channel = args.channel or scene.radar.channels[0]
    rows = [{"mechanism": e.mechanism, "bounces": e.bounces, "rcs_m2": e.rcs} for e in echoes]
    if folder is not None:
        with folder.writing(RECORD) as path:
            record = {"scene": scene.name, "object": args.only, "channel": channel, "rows": rows}
            parameter_file.write(path, record)
    lines = [f"{scene.name}, {args.only}, {channel}: radar cross section by mechanism, of one look"]
    lines.append(f"{'bounces':>7}  {'mechanism':<21} {'dBsm':>6}")
    lines += [f"{e.bounces or '-':>7}  {e.mechanism:<21} {10.0 * log10(e.rcs):6.1f}" for e in echoes]
    if not echoes:
        lines.append("no echo of it in the image")
    console.say(json.dumps(rows, indent=2) if args.json else "\n".join(lines))
    return 0


def list_rows(study: "DepthStudy") -> list[dict[str, float | int | None]]:
    """Rows as JSON has them: None for numbers that are not finite."""
    from math import isfinite

    return [
        {
            "bounces": row.bounces,
            "error_db": row.error_db if isfinite(row.error_db) else None,
            "energy_db": row.energy_db if isfinite(row.energy_db) else None,
            "changed": row.changed,
            "seconds": row.seconds if isfinite(row.seconds) else None,
        }
        for row in study.rows
    ]


def format_table(study: "DepthStudy") -> str:
    """The table as text."""
    deepest = len(study.rows)
    lines = [
        f"{study.scene}, {study.channel}: the image that ends at each bounce against {deepest} bounces, same rays",
        f"{'bounces':>7} {'error dB':>9} {'bounce alone dB':>16} {'pixels changed':>15} {'CPU s':>8}",
    ]
    for row, values in zip(study.rows, list_rows(study), strict=True):
        error, energy, seconds = (values[name] for name in ("error_db", "energy_db", "seconds"))
        lines.append(
            f"{row.bounces:7d} {'none' if error is None else f'{error:.1f}':>9} "
            f"{'none' if energy is None else f'{energy:.1f}':>16} {100.0 * row.changed:13.1f} % "
            f"{'-' if seconds is None else f'{seconds:.2f}':>8}"
        )
    return "\n".join(lines)


def _save(
    folder: "OutputFolder", study: "DepthStudy", rows: list[dict[str, float | int | None]], console: Console
) -> None:
    from sarmitsuba.commands.results import draw_into
    from sarmitsuba.machine import output as parameter_file
    from sarmitsuba.view.charts import depth_figure

    with folder.writing(RECORD) as path:
        parameter_file.write(path, {"scene": study.scene, "channel": study.channel, "rows": rows})
    errors, energies, seconds = (
        [getattr(row, name) for row in study.rows] for name in ("error_db", "energy_db", "seconds")
    )
    title = f"{study.scene}, {study.channel}"
    draw_into(folder, CHART, partial(depth_figure, errors, energies, seconds, title), console)
    draw_into(folder, PICTURES, partial(_draw_images, study, alone=False), console)
    draw_into(folder, ORDERS, partial(_draw_images, study, alone=True), console)


def _draw_images(study: "DepthStudy", *, alone: bool) -> "Figure":
    """Images that end at the first bounces, or of these bounces alone, on the scale of the deepest image."""
    from sarmitsuba.view.charts import side_by_side
    from sarmitsuba.view.display import LARGEST, PictureOptions, prepare

    deepest = prepare(
        study.image_up_to(len(study.rows)), PictureOptions(study.channel, span_db=SPAN_DB), LARGEST
    )
    options = PictureOptions(study.channel, limits=deepest.limits)
    shown = range(1, min(SHOWN, len(study.rows)) + 1)
    pictures = [
        (
            f"bounce {n} alone" if alone else "1 bounce" if n == 1 else f"{n} bounces",
            study.image_of(n) if alone else study.image_up_to(n),
            options,
        )
        for n in shown
    ]
    return side_by_side(pictures, f"{study.scene}, {study.channel}")
