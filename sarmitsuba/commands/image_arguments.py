"""Arguments that name an image, the same for every command that takes one."""

import argparse
import os
from pathlib import Path

from sarmitsuba.errors import DataError


def add_image_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the image itself and the channel of it."""
    parser.add_argument(
        "image", metavar="OUT", help="folder that `render` or `focus` wrote, or an image file (image.h5)"
    )
    parser.add_argument("--channel", metavar="NAME", help="polarisation, such as HV (default: the first)")


def add_axes_argument(parser: argparse.ArgumentParser) -> None:
    """Add the frame of the axes of a picture."""
    parser.add_argument(
        "--axes",
        choices=("scene", "radar"),
        help="what the axes of the picture count: scene, coordinates of the scene, on ground grids; radar, metres from "
        "the image's centre, or slant range (default: scene on the ground, else radar)",
    )


def add_scene_picture_arguments(parser: argparse.ArgumentParser) -> None:
    """Add what a picture shows of the scene."""
    parser.add_argument(
        "--outlines",
        action="store_true",
        help="draw footprints of bodies (solid) and their upper rims where layover shows them (dashed)",
    )
    parser.add_argument(
        "--with-view", action="store_true", help="draw the scene seen from above beside the image"
    )


def image_file(given: Path) -> Path:
    """The image file that ``render`` or ``focus`` wrote into a folder; a file is taken as it is.

    Raises
    ------
    DataError
        There is no image in the folder.
    """
    if not os.path.isdir(given):
        return given
    found = _first(given, _image_names())
    if found is None:
        raise DataError(f"{given}: holds no image; one of {', '.join(_image_names())} is needed")
    return found


def files_of_run(folder: Path) -> tuple[Path | None, Path | None]:
    """The image and the raw data that ``render`` wrote into a folder; None for what is not there."""
    from sarmitsuba.io import FORMATS

    raw = [f"raw{suffix}" for entry in FORMATS if entry.read_raw for suffix in entry.suffixes]
    return _first(folder, _image_names()), _first(folder, raw)


def _image_names() -> list[str]:
    from sarmitsuba.io import FORMATS

    return [f"image{suffix}" for entry in FORMATS if entry.read_image for suffix in entry.suffixes]


def _first(folder: Path, names: list[str]) -> Path | None:
    return next((folder / name for name in names if os.path.isfile(folder / name)), None)
