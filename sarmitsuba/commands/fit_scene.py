"""Fit parameters of a scene (levels, permittivity, shifts, the track) to raw data; prints values, sigma and bound."""

import argparse
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from sarmitsuba.commands.console import Console
from sarmitsuba.commands.scene_arguments import add_scene_arguments, scene_of

if TYPE_CHECKING:
    from sarmitsuba.apps.fit.least_squares import Prior
    from sarmitsuba.signal.raw_data import RawData
    from sarmitsuba.view.figure import Figure

NAME = "fit"
HELP = "fit parameters of a scene (material levels, roughness, shifts, the track) to raw data"

TABLE, RESIDUAL, PICTURE = "fit.json", "residual.h5", "residual.png"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this command's arguments."""
    add_scene_arguments(parser)
    parser.add_argument(
        "--data",
        required=True,
        nargs="+",
        metavar="RAW",
        help="raw data of the scene's radar, such as raw.h5 of render; several: looks, each with the radar of its data",
    )
    parser.add_argument(
        "--parameters",
        required=True,
        metavar="NAMES",
        help="separated by commas: gain, clock_offset, track:KNOTS, levels, level:MATERIAL, permittivity:MATERIAL, "
        "rms_height:MATERIAL, shift:SHAPE:AXIS, ... (docs/gradients.md)",
    )
    parser.add_argument(
        "--by",
        choices=("complex", "amplitude"),
        default="complex",
        help="complex samples (default), or multilooked amplitude, for scatterers of unknown phase",
    )
    parser.add_argument(
        "--prior",
        action="append",
        default=[],
        metavar="NAME=MEAN:SIGMA",
        help="what is known of a value beforehand: mean and standard deviation; may be repeated",
    )
    parser.add_argument(
        "--iterations", type=int, default=20, metavar="N", help="largest number of steps (default: 20)"
    )
    parser.add_argument(
        "-o",
        "--output",
        metavar="FOLDER",
        help=f"folder for {TABLE}, and of each look {RESIDUAL} and its picture (default: none)",
    )


def run(args: argparse.Namespace, console: Console) -> int:
    """Fit, print the table, write the results."""
    from sarmitsuba.apps.fit.fit import fit
    from sarmitsuba.apps.fit.multilooked import window_of
    from sarmitsuba.commands.results import draw_into
    from sarmitsuba.core.errors import SceneError
    from sarmitsuba.files import read_raw, write_raw
    from sarmitsuba.machine import output as parameter_file
    from sarmitsuba.machine.backend import ensure_backend
    from sarmitsuba.machine.output import OutputFolder, output_folder

    if args.iterations < 1:
        raise SceneError(f"fit: --iterations = {args.iterations} must be at least 1")
    priors = dict(_prior(text) for text in args.prior)
    tables = _names(RESIDUAL, len(args.data)), _names(PICTURE, len(args.data))
    if args.output:
        OutputFolder(Path(args.output)).check_names((TABLE, *tables[0], *tables[1]))
    if len(args.data) > 1 and args.radar:
        raise SceneError(
            "fit: --radar with several --data: each look has the radar of its data; leave it out"
        )
    ensure_backend()
    scene, data = scene_of(args), [read_raw(path) for path in args.data]
    found = fit(
        scene,
        data,
        args.parameters,
        by=args.by,
        priors=priors,
        iterations=args.iterations,
        progress=lambda step, cost: console.note(
            f"step {step}: residual {cost:.4g}"
            + (f", averaged over {window_of(step):g} range cells" if args.by == "amplitude" else " W")
        ),
    )
    console.say(found.table())
    if args.output:
        with output_folder(Path(args.output)) as folder:
            with folder.writing(TABLE) as path:
                record = {"command": "fit", "data": [str(path) for path in args.data], "scene": scene.name}
                parameter_file.write(path, {**record, "by": args.by, **found.as_dict()})
            for name, picture, raw, left in zip(*tables, data, found.residuals, strict=True):
                with folder.writing(name) as path:
                    write_raw(left, path)
                draw_into(folder, picture, partial(_picture, raw, left), console)
        console.say(str(Path(args.output) / TABLE))
    return 0


def _names(name: str, count: int) -> list[str]:
    """File names of every look: the name itself for the first, numbered for others."""
    stem, dot, suffix = name.partition(".")
    return [name] + [f"{stem}_{k}{dot}{suffix}" for k in range(2, count + 1)]


def _picture(measured: "RawData", left: "RawData") -> "Figure":
    from sarmitsuba.signal.focusing import focus
    from sarmitsuba.signal.image import SarImage
    from sarmitsuba.view.charts import residual_picture

    images = [focus(replace(left, data=raw.data, layers=raw.layers)) for raw in (measured, left)]
    assert all(isinstance(image, SarImage) for image in images)
    return residual_picture(*images)


def _prior(text: str) -> "tuple[str, Prior]":
    from sarmitsuba.apps.fit.least_squares import Prior
    from sarmitsuba.core.errors import SceneError

    name, equals, value = text.rpartition("=")
    mean, colon, sigma = value.partition(":")
    try:
        if not (equals and colon):
            raise ValueError
        return name, Prior(float(mean), float(sigma))
    except ValueError:
        raise SceneError(
            f"fit: --prior {text!r} is not of the form NAME=MEAN:SIGMA, such as level:soil=-10:2"
        ) from None
