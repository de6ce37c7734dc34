"""Arguments that name an image, the same for every command that takes one."""

import argparse
from pathlib import Path

from sarmitsuba.errors import DataError


def add_image_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the image itself and the channel of it."""
    parser.add_argument(
        "image", metavar="OUT", help="folder that `render` or `focus` wrote, or an image file (image.h5)"
    )
    parser.add_argument("--channel", metavar="NAME", help="polarisation, such as HV (default: the first)")


def image_file(given: Path) -> Path:
    """The image file that ``render`` or ``focus`` wrote into a folder; a file is taken as it is.

    Raises
    ------
    DataError
        There is no image in the folder.
    """
    from sarmitsuba.io import FORMATS

    if not given.is_dir():
        return given
    names = [f"image{suffix}" for entry in FORMATS if entry.read_image for suffix in entry.suffixes]
    found = [given / name for name in names if (given / name).is_file()]
    if not found:
        raise DataError(f"{given}: there is no image in it; one of {', '.join(names)} is needed")
    return found[0]


def raw_file(folder: Path) -> Path | None:
    """The raw data that ``render`` wrote into a folder; None where there are none."""
    from sarmitsuba.io import FORMATS

    names = [f"raw{suffix}" for entry in FORMATS if entry.read_raw for suffix in entry.suffixes]
    return next((folder / name for name in names if (folder / name).is_file()), None)


__all__ = ["add_image_arguments", "image_file", "raw_file"]
