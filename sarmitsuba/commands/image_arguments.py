"""Arguments that name an image, the same for every command that takes one."""

import argparse
import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from sarmitsuba.core.errors import DataError

if TYPE_CHECKING:
    from sarmitsuba.scene.scene import Scene
    from sarmitsuba.signal.image import SarImage
    from sarmitsuba.view.display import PictureOptions
    from sarmitsuba.view.figure import Figure


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


def add_label_arguments(parser: argparse.ArgumentParser) -> None:
    """Add labels of the image's pixels."""
    parser.add_argument(
        "--labels",
        action="store_true",
        help="also write labels of the image's pixels: layover and shadow, positions, shapes, mechanisms, materials "
        "(docs/labels.md)",
    )
    parser.add_argument(
        "--classes",
        metavar="FILE",
        help='table (TOML or JSON) of the semantic class of shapes, for --labels: "building*" = "building"',
    )


def class_argument(args: argparse.Namespace, scene: "Scene") -> dict[str, str] | None:
    """Table of classes of the command line, checked against a scene; None without.

    Raises
    ------
    DataError
        One line: the table cannot be read, or names no shape of the scene.
    """
    if args.classes is None:
        return None
    from sarmitsuba.analysis.label_classes import checked_classes, read_classes

    table = read_classes(args.classes)
    checked_classes(scene, table)
    return table


def add_scene_picture_arguments(parser: argparse.ArgumentParser, *, loads: bool = True) -> None:
    """Add arguments for the scene in a picture; ``loads``: the command loads the scene for this alone."""
    parser.add_argument(
        "--outlines",
        action="store_true",
        help="draw footprints of bodies (solid) and their upper rims where layover shows them (dashed)",
    )
    parser.add_argument(
        "--with-view", action="store_true", help="draw the scene seen from above beside the image"
    )
    if loads:
        parser.add_argument(
            "--allow-outside",
            action="store_true",
            help="let the scene refer to files outside its own folder, as for render",
        )


@dataclass(frozen=True, eq=False)
class PictureStyle:
    """Axes of the pictures of images, and parts of the scene that they show.

    Parameters
    ----------
    axes : frame of the axes, see :class:`sarmitsuba.signal.image.ShownAxes`; None: of the scene on ground
        grids
    scene : of the image; needed only for the following
    outlined, with_plan : draw outlines of bodies, and the scene from above beside the image
    labelled : also write labels of the image's pixels
    classes : of shapes, by name or pattern; None: there are none
    """

    axes: str | None = None
    scene: "Scene | None" = None
    outlined: bool = False
    with_plan: bool = False
    labelled: bool = False
    classes: Mapping[str, str] | None = None

    @staticmethod
    def of(
        args: argparse.Namespace, scene: "Callable[[], Scene]", *, labelled: bool = False
    ) -> "PictureStyle":
        """Style of the command line; ``scene`` is called where a picture or labels show something of it.

        Raises
        ------
        DataError
            The table of classes cannot be read, or names no shape of the scene.
        """
        needed = args.outlines or args.with_view or labelled
        shown = scene() if needed else None
        classes = class_argument(args, shown) if labelled and shown is not None else None
        return PictureStyle(args.axes, shown, args.outlines, args.with_view, labelled, classes)

    def options(self, options: "PictureOptions") -> "PictureOptions":
        """Options of a picture with these axes."""
        return replace(options, axes=self.axes)

    def figure(self, image: "SarImage", options: "PictureOptions", title: str | None = None) -> "Figure":
        """Quick-look of an image."""
        from sarmitsuba.view.quicklook import quicklook

        return quicklook(
            image,
            self.options(options),
            title=title,
            scene=self.scene,
            outlined=self.outlined,
            with_plan=self.with_plan,
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
    """The image and the raw data that ``render`` wrote into a folder; None for a missing one."""
    from sarmitsuba.files import FORMATS

    raw = [f"raw{suffix}" for entry in FORMATS if entry.read_raw for suffix in entry.suffixes]
    return _first(folder, _image_names()), _first(folder, raw)


def _image_names() -> list[str]:
    from sarmitsuba.files import FORMATS

    return [f"image{suffix}" for entry in FORMATS if entry.read_image for suffix in entry.suffixes]


def _first(folder: Path, names: list[str]) -> Path | None:
    return next((folder / name for name in names if os.path.isfile(folder / name)), None)
