"""Fit parameters of a scene (levels, permittivity, shifts, the track) to raw data; prints values, sigma and bound."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from sarmitsuba.commands.console import Console
from sarmitsuba.commands.scene_arguments import add_scene_arguments, scene_of

if TYPE_CHECKING:
    from sarmitsuba.gradients.least_squares import Prior

NAME = "fit"
HELP = "fit parameters of a scene (material levels, roughness, shifts, the track) to raw data"

TABLE, RESIDUAL, PICTURE = "fit.json", "residual.h5", "residual.png"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this command's arguments."""
    add_scene_arguments(parser)
    parser.add_argument(
        "--data", required=True, metavar="RAW", help="raw data of the scene's radar, such as raw.h5 of render"
    )
    parser.add_argument(
        "--parameters",
        required=True,
        metavar="NAMES",
        help="separated by commas: gain, clock_offset, track:KNOTS, levels, level:MATERIAL, permittivity:MATERIAL, "
        "rms_height:MATERIAL, shift:SHAPE:AXIS, ... (docs/gradients.md)",
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
        help=f"folder for {TABLE}, {RESIDUAL} and {PICTURE} (default: none)",
    )


def run(args: argparse.Namespace, console: Console) -> int:
    """Fit, print the table, write the results."""
    from sarmitsuba.backend import ensure_backend
    from sarmitsuba.errors import SceneError
    from sarmitsuba.gradients.fit import fit
    from sarmitsuba.io import parameter_file, read_raw, write_raw
    from sarmitsuba.io.output import OutputFolder, output_folder
    from sarmitsuba.view.quicklook import save
    from sarmitsuba.view.residual_picture import residual_figure

    if args.iterations < 1:
        raise SceneError(f"fit: --iterations = {args.iterations} must be at least 1")
    priors = dict(_prior(text) for text in args.prior)
    if args.output:
        OutputFolder(Path(args.output)).check_names((TABLE, RESIDUAL, PICTURE))
    ensure_backend()
    scene, data = scene_of(args), read_raw(args.data)
    found = fit(
        scene,
        data,
        args.parameters,
        priors=priors,
        iterations=args.iterations,
        progress=lambda step, cost: console.note(f"step {step}: residual {cost:.4g} W"),
    )
    console.say(found.table())
    if args.output:
        with output_folder(Path(args.output)) as folder:
            with folder.writing(TABLE) as path:
                parameter_file.write(
                    path, {"command": "fit", "data": str(args.data), "scene": scene.name, **found.as_dict()}
                )
            with folder.writing(RESIDUAL) as path:
                write_raw(found.residual, path)
            with folder.writing(PICTURE) as path:
                save(residual_figure(data, found.residual), path)
        console.say("\n".join(str(Path(args.output) / name) for name in (TABLE, PICTURE)))
    return 0


def _prior(text: str) -> "tuple[str, Prior]":
    from sarmitsuba.errors import SceneError
    from sarmitsuba.gradients.least_squares import Prior

    name, equals, value = text.partition("=")
    mean, colon, sigma = value.partition(":")
    try:
        if not (equals and colon):
            raise ValueError
        return name, Prior(float(mean), float(sigma))
    except ValueError:
        raise SceneError(
            f"fit: --prior {text!r} is not of the form NAME=MEAN:SIGMA, such as level:soil=-10:2"
        ) from None
