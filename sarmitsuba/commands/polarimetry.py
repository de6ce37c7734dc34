"""Decompose an image of several polarisations.

HH, HV, VH, VV: the Pauli colour composite; entropy, anisotropy and alpha (Cloude and Pottier) as maps and as the
H-alpha plane. RH, RV (LH, LV): the m-chi and m-delta composites. See docs/analysis.md.
"""

import argparse
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from sarmitsuba.commands.console import Console
from sarmitsuba.commands.image_arguments import image_file

if TYPE_CHECKING:
    from sarmitsuba.view.quicklook import Drawing

NAME = "polarimetry"
HELP = "Pauli colours, entropy, anisotropy, alpha of quad-pol images; m-chi, m-delta of compact ones"

TABLE = "polarimetry.json"
PAULI, MAPS, PLANE, M_CHI, M_DELTA = (
    "pauli.png",
    "h_a_alpha.png",
    "h_alpha_plane.png",
    "m_chi.png",
    "m_delta.png",
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this command's arguments."""
    parser.add_argument(
        "image", metavar="OUT", help="folder that `render` or `focus` wrote, or an image file (image.h5)"
    )
    parser.add_argument(
        "-o",
        "--output",
        metavar="FOLDER",
        help=f"folder for {TABLE} and the pictures (default: the folder of the image)",
    )
    parser.add_argument(
        "--looks",
        nargs=2,
        type=int,
        metavar=("AZIMUTH", "RANGE"),
        help="size of the averaging window in pixels (default: 5 x 5 resolution cells; for the Pauli colours one cell)",
    )
    parser.add_argument(
        "--targets",
        metavar="CSV",
        help="calibrate first: trihedrals and dihedrals, one a line under the header kind,x_m,y_m,z_m,rotation_deg",
    )


def run(args: argparse.Namespace, console: Console) -> int:
    """Decompose."""
    from sarmitsuba.analysis.polarimetric_calibration import calibrate_polarimetry, read_targets
    from sarmitsuba.analysis.polarimetry import (
        automatic_looks,
        coherency,
        colours,
        m_chi,
        m_delta,
        pauli_rgb,
        polarimetry_report,
        quad_pol,
    )
    from sarmitsuba.commands.results import draw_into
    from sarmitsuba.files import read_image
    from sarmitsuba.machine import output as parameter_file
    from sarmitsuba.machine.output import OutputFolder, output_folder
    from sarmitsuba.view.polarimetric_maps import composite_figure, maps_figure, plane_figure

    source = image_file(Path(args.image))
    target = Path(args.output or source.parent)
    OutputFolder(target).check_names((TABLE,))
    image = read_image(source)
    calibration = {}
    if args.targets:
        found = calibrate_polarimetry(image, read_targets(args.targets))
        image, calibration = found.correct(image), {"calibration": found.as_dict()}
        console.say(str(found))
    report = polarimetry_report(image, tuple(args.looks) if args.looks else None)
    console.say(report.as_table())
    figures: dict[str, Drawing] = {}
    if report.decomposition is not None:
        # colours need no averaging: full resolution of the image
        block = tuple(args.looks) if args.looks else automatic_looks(image, 1.0)
        figures[PAULI] = partial(
            composite_figure,
            image,
            pauli_rgb(coherency(quad_pol(image), block)),
            block,
            "Pauli basis",
            "red |HH - VV|, green 2 |HV|, blue |HH + VV|",
        )
        figures[MAPS] = partial(maps_figure, image, report)
        figures[PLANE] = partial(plane_figure, report.decomposition)
    if report.stokes is not None:
        legend = "red even bounces, green unpolarised, blue odd bounces"
        for name, title, powers in (
            (M_CHI, "m-chi", m_chi(report.stokes)),
            (M_DELTA, "m-delta", m_delta(report.stokes)),
        ):
            figures[name] = partial(composite_figure, image, colours(powers), report.looks, title, legend)
    with output_folder(target) as folder:
        with folder.writing(TABLE) as path:
            parameter_file.write(
                path, {"command": NAME, "image": str(source), **calibration, **report.as_dict()}
            )
        for name, draw in figures.items():
            console.say(str(draw_into(folder, name, draw, console)))
    return 0
