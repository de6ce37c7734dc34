"""Image quality measures: point targets, areas, looks; as table, JSON and plot.

IRW: half-power width of the main lobe. PSLR: highest side lobe beyond the first nulls over the peak. ISLR: energy
beyond the first nulls over that between them, out to 16 cells. ENL: squared mean over variance of the intensity;
contrast: its standard deviation over its mean; entropy: that of the intensities over their sum. See docs/analysis.md.
"""

import argparse
from pathlib import Path

from sarmitsuba.commands.console import Console
from sarmitsuba.commands.image_arguments import add_axes_argument, add_image_arguments, image_file

NAME = "quality"
HELP = "measure point targets (IRW, PSLR, ISLR, place, phase) and areas (ENL, contrast, entropy) of an image"

TABLE, PLOT = "quality.json", "quality.png"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this command's arguments."""
    add_image_arguments(parser)
    parser.add_argument(
        "-o",
        "--output",
        metavar="FOLDER",
        help=f"folder for {TABLE} and {PLOT} (default: the folder of the image)",
    )
    parser.add_argument(
        "--point",
        nargs="+",
        type=float,
        action="append",
        metavar="X",
        help="position x y [z] of a point target, m in the frame of the scene's file (z: the image's "
        "plane); may be given several times "
        "(default: the scene's point scatterers, else points are found)",
    )
    parser.add_argument(
        "--most",
        type=int,
        default=12,
        metavar="N",
        help="largest number of point targets to find (default: 12)",
    )
    parser.add_argument(
        "--area",
        nargs=4,
        type=float,
        action="append",
        metavar=("AZIMUTH0", "AZIMUTH1", "RANGE0", "RANGE1"),
        help="rectangle, m as on the axes of the picture: from below to above, then from left to right; may be given "
        "several times (default: the most homogeneous and the darkest square of 24 cells)",
    )
    add_axes_argument(parser)
    parser.add_argument(
        "--looks",
        nargs=2,
        type=int,
        default=(1, 1),
        metavar=("AZIMUTH", "RANGE"),
        help="parts of the spectrum whose powers are averaged before areas are measured (default: 1 1)",
    )


def run(args: argparse.Namespace, console: Console) -> int:
    """Measure."""
    import numpy as np

    from sarmitsuba.analysis.image_quality import Area, image_quality
    from sarmitsuba.analysis.point_quality import KnownPoint
    from sarmitsuba.commands.results import draw_into
    from sarmitsuba.core.errors import DataError
    from sarmitsuba.files import read_image
    from sarmitsuba.machine import output as parameter_file
    from sarmitsuba.machine.output import OutputFolder, output_folder
    from sarmitsuba.signal.image import ShownAxes
    from sarmitsuba.view.charts import quality_figure

    source = image_file(Path(args.image))
    target = Path(args.output or source.parent)
    OutputFolder(target).check_names((TABLE, PLOT))
    image = read_image(source)
    points = None
    if args.point:
        if not all(2 <= len(values) <= 3 for values in args.point):
            raise DataError("--point: give x y or x y z, m")
        plane = image.grid.height + float(image.grid.offset[2])
        points = [KnownPoint((v[0], v[1], v[2] if len(v) > 2 else plane)) for v in args.point]
    axes = ShownAxes.of(image.grid, args.axes)
    areas = None
    if args.area:
        given = np.array(args.area)
        azimuth, range_ = (np.sort(side) for side in axes.grid_coordinates(given[:, 2:], given[:, :2]))
        areas = [
            Area((float(a[0]), float(a[1])), (float(r[0]), float(r[1])))
            for a, r in zip(azimuth, range_, strict=True)
        ]
    report = image_quality(
        image, points, areas, channel=args.channel, looks=tuple(args.looks), most=args.most
    )
    console.say(report.as_table())
    with output_folder(target) as folder:
        with folder.writing(TABLE) as path:
            parameter_file.write(path, {"command": "quality", "image": str(source), **report.as_dict()})
        path = draw_into(folder, PLOT, lambda: quality_figure(image, report, args.axes), console)
    console.say(str(path))
    return 0
