"""Draw the picture of a saved image again with other limits, colours, quantity, channel or looks; no simulation."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from sarmitsuba.commands.console import Console
from sarmitsuba.commands.image_arguments import (
    PictureStyle,
    add_axes_argument,
    add_image_arguments,
    add_scene_picture_arguments,
    image_file,
)

if TYPE_CHECKING:
    from sarmitsuba.scene.scene import Scene

NAME = "picture"
HELP = "draw the picture of an image again, with other limits, colours, quantity, channel or looks"

_QUANTITIES = ("sigma0", "gamma0", "beta0", "rcs", "amplitude", "phase")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this command's arguments."""
    add_image_arguments(parser)
    parser.add_argument(
        "-o",
        "--output",
        metavar="FILE",
        help="file to write, PNG, JPEG, PDF or SVG by its suffix (default: overwrite the quick-look of that channel "
        "beside the image)",
    )
    parser.add_argument("--force", action="store_true", help="replace FILE where it exists")
    parser.add_argument(
        "--quantity",
        choices=_QUANTITIES,
        default="sigma0",
        help="what to show: sigma0, gamma0, beta0, rcs in dB; amplitude, m; phase, rad (default: sigma0)",
    )
    parser.add_argument(
        "--limits",
        nargs=2,
        type=float,
        metavar=("BLACK", "WHITE"),
        help="values at both ends of the colour scale (default: from the image)",
    )
    parser.add_argument(
        "--span",
        type=float,
        default=50.0,
        metavar="DB",
        help="dynamic range of the colour scale without --limits (default: 50)",
    )
    parser.add_argument(
        "--colour-map", metavar="NAME", help="Matplotlib colour map, such as viridis (default: gray)"
    )
    parser.add_argument(
        "--looks",
        nargs=2,
        type=int,
        metavar=("AZIMUTH", "RANGE"),
        help="pixels averaged into one (multi-look; default: 1 1, or more in large images of speckle throughout)",
    )
    parser.add_argument(
        "--spectral-looks",
        nargs=2,
        type=int,
        default=(1, 1),
        metavar=("AZIMUTH", "RANGE"),
        help="parts of the spectrum (sub-apertures, sub-bands) whose powers are averaged (multi-look)",
    )
    parser.add_argument(
        "--order", type=int, metavar="N", help="one bounce number only, where the image keeps them apart"
    )
    add_axes_argument(parser)
    add_scene_picture_arguments(parser)
    parser.add_argument("--title", help="first line above the picture (default: the scene's name)")


def scene_of(folder: Path, *, allow_outside: bool) -> "Scene":
    """Scene of the run in a folder, loaded again for its pictures."""
    from sarmitsuba.machine.backend import ensure_backend
    from sarmitsuba.view.page.run_folder import scene_of_run

    ensure_backend()
    return scene_of_run(folder, allow_outside=allow_outside)


def run(args: argparse.Namespace, console: Console) -> int:
    """Draw."""
    from sarmitsuba.commands.results import picture_name
    from sarmitsuba.files import read_image
    from sarmitsuba.machine.output import OutputFile, OutputFolder
    from sarmitsuba.view.display import PictureOptions
    from sarmitsuba.view.quicklook import picture_format, save

    if args.output:
        picture_format(args.output)
    source = image_file(Path(args.image))
    file = OutputFile(args.output, force=args.force) if args.output else None
    image = read_image(source)
    options = PictureOptions(
        channel=args.channel,
        quantity=args.quantity,
        limits=tuple(args.limits) if args.limits else None,
        span_db=args.span,
        colour_map=args.colour_map,
        looks=tuple(args.looks) if args.looks else None,
        order=args.order,
        spectral_looks=tuple(args.spectral_looks),
    )
    style = PictureStyle.of(args, lambda: scene_of(source.parent, allow_outside=args.allow_outside))
    figure = style.figure(image, options, args.title)
    name = picture_name(image.channels, args.channel)
    with file.writing() if file else OutputFolder(source.parent).writing(name) as target:
        save(figure, target)
    console.say(str(target))
    return 0
