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
    from sarmitsuba.signal.image import SarImage

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
    parser.add_argument(
        "--only",
        metavar="NAME",
        help='the pixels of one object alone, such as a building, or of several by a pattern such as "house*"; needs '
        "labels.h5 (render --labels) beside the image",
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


# pixels about an object, over the size of its box
_MARGIN = 0.25


def pick_object(image: "SarImage", folder: Path, name: str) -> "SarImage":
    """The part of an image about an object, zero where echoes of others dominate.

    Parameters
    ----------
    image : whole
    folder : with its ``labels.h5``
    name : of instances, or a pattern

    Raises
    ------
    DataError
        The folder has no labels of this image, or the object has no pixel in it.
    """
    from dataclasses import replace
    from fnmatch import fnmatchcase

    import numpy as np

    from sarmitsuba.commands.label_files import LABELS
    from sarmitsuba.core.errors import DataError
    from sarmitsuba.core.parameters import did_you_mean, one_line
    from sarmitsuba.signal.pixel_labels import Labels

    labels = Labels.load(folder / LABELS)
    instance = labels["instance"]
    if instance.shape != image.grid.shape:
        raise DataError(f"{folder / LABELS}: is of another image; render again with --labels --force")
    known = [one.name for one in labels.instances]
    picked = [one for one in labels.instances if one.name == name or fnmatchcase(one.name, name)]
    if not picked:
        raise DataError(f'{folder / LABELS}: no object "{one_line(name)}"{did_you_mean(name, known)}')
    own = np.isin(instance, [one.number for one in picked]) & (labels["instance_here"] == 1)
    rows, columns = (np.flatnonzero(own.any(axis=axis)) for axis in (1, 0))
    if not rows.size:
        raise DataError(f'{folder / LABELS}: no pixel of the image is dominated by "{one_line(name)}"')
    cut = []
    for found, n in zip((rows, columns), own.shape, strict=True):
        margin = 4 + int(_MARGIN * (found[-1] - found[0]))
        cut.append(slice(max(0, int(found[0]) - margin), min(n, int(found[-1]) + margin + 1)))
    grid = replace(image.grid, azimuth=image.grid.azimuth[cut[0]], range=image.grid.range[cut[1]])
    data = np.where(own, image.data, 0)[:, cut[0], cut[1]]
    return replace(image, data=data, grid=grid, incidence_angle=image.incidence_angle[cut[1]])


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
    if args.only is not None:
        image = pick_object(image, source.parent, args.only)
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
