"""Differentiate the image of a scene by one parameter, and draw the change."""

import argparse
import math
from pathlib import Path

from sarmitsuba.commands.console import Console
from sarmitsuba.commands.scene_arguments import add_scene_arguments, scene_of
from sarmitsuba.core.constants import DEFAULT_WINDOW

NAME = "derivative"
HELP = "draw how the image changes with a parameter of the scene: a wall that moves, a material's level"

TABLE, IMAGE, PICTURE = "derivative.json", "derivative.h5", "derivative.png"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this command's arguments."""
    add_scene_arguments(parser)
    parser.add_argument(
        "--parameter",
        metavar="NAME",
        help="shift:SHAPE:AXIS, height:SHAPE, scale:SHAPE, rotation:SHAPE, level:MATERIAL, permittivity:MATERIAL, ... "
        "(docs/gradients.md); without it, those of the scene are listed",
    )
    parser.add_argument(
        "--change",
        type=_finite,
        metavar="VALUE",
        help="change of the value that is drawn, in its unit (default: as far as first order is of use)",
    )
    parser.add_argument(
        "--simulate", action="store_true", help="simulate the change as well, and say how exact it is"
    )
    parser.add_argument(
        "--window", default=DEFAULT_WINDOW, help=f"window against side lobes (default: {DEFAULT_WINDOW})"
    )
    parser.add_argument(
        "-o",
        "--output",
        metavar="FOLDER",
        help=f"folder for {PICTURE}, {IMAGE} and {TABLE} (default: derivative_ and the scene's name)",
    )


def run(args: argparse.Namespace, console: Console) -> int:
    """Differentiate, draw, write the results; without a parameter list those of the scene."""
    from sarmitsuba.apps.fit.changed_view import ChangedView, derivative_figure
    from sarmitsuba.apps.fit.image_derivative import image_derivative
    from sarmitsuba.apps.fit.parsing import list_parameters
    from sarmitsuba.core.errors import SceneError
    from sarmitsuba.files import write_image
    from sarmitsuba.machine import output as parameter_file
    from sarmitsuba.machine.backend import ensure_backend
    from sarmitsuba.machine.output import OutputFolder, output_folder
    from sarmitsuba.view.quicklook import save

    if args.parameter is None:
        if args.change is not None or args.simulate:
            raise SceneError("--change and --simulate are of a parameter; give --parameter")
        ensure_backend()
        console.say("\n".join(list_parameters(scene_of(args))))
        return 0
    out = Path(args.output or f"derivative_{Path(args.scene).stem}")
    OutputFolder(out).check_names((TABLE, IMAGE, PICTURE))
    ensure_backend()
    scene = scene_of(args)
    found = image_derivative(scene, args.parameter, leave_out=True, window=args.window)
    shown = ChangedView.of(found).by(found.largest_change if args.change is None else args.change)
    if args.simulate:
        shown = shown.with_simulation()
    first, *rest = shown.lines()
    console.say("\n".join([f"{args.parameter}: {first}", *rest]))
    with output_folder(out) as folder:
        with folder.writing(IMAGE) as path:
            write_image(found.derivative, path)
        with folder.writing(PICTURE) as path:
            save(derivative_figure(shown), path)
        with folder.writing(TABLE) as path:
            parameter_file.write(path, {"command": NAME, "scene": scene.name, **shown.as_dict()})
    console.say(str(out / PICTURE))
    return 0


def _finite(text: str) -> float:
    """A finite number."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise argparse.ArgumentTypeError(f"{text!r} is no finite number; give one, without its unit")
    return value
