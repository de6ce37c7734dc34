"""List the shipped scenes and radars, or copy a scene with all its files to start another."""

import argparse
import os
import shutil
from pathlib import Path

from sarmitsuba.commands.console import Console
from sarmitsuba.core.errors import OutputError, SceneError

NAME = "scenes"
HELP = "list or copy the shipped scenes"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this command's arguments."""
    parser.add_argument(
        "--copy",
        nargs=2,
        metavar=("NAME", "DIR"),
        help="copy a shipped scene and its meshes into the folder DIR",
    )


def run(args: argparse.Namespace, console: Console) -> int:
    """List or copy."""
    from sarmitsuba.loading import library

    if args.copy:
        name, target = args.copy
        written = copy_scene(library.resolve(name), Path(target))
        console.say("\n".join(str(path) for path in written))
        return 0
    scenes, radars = library.list_scenes(), library.list_radars()
    width = max((len(entry.name) for entry in (*scenes, *radars)), default=0)
    console.say("scenes:")
    for entry in scenes:
        console.say(f"  {entry.name:<{width}}  {entry.title}")
    console.say("radars (--radar):")
    for entry in radars:
        console.say(f"  {entry.name:<{width}}  {entry.title}")
    return 0


def copy_scene(scene: Path, target: Path) -> list[Path]:
    """Copy a scene file and the files it refers to, in the same folders below ``target``.

    Raises
    ------
    OutputError
        One of the files exists already, or cannot be written. Nothing is copied then.
    """
    from sarmitsuba.loading.references import document_files
    from sarmitsuba.machine.atomic import atomic_path, make_folder
    from sarmitsuba.machine.regular_files import is_inside

    root = Path(os.path.realpath(scene.parent))
    sources = document_files(scene, strict=True)
    for source in sources:
        if not source.is_relative_to(root) or ".." in source.parts or not is_inside(source, root):
            raise SceneError(f"{scene}: refers to {source}, outside its own folder; copy that file by hand")
        if not os.path.isfile(source):
            raise SceneError(
                f"{scene}: refers to {source}, which does not exist; restore the file or correct the reference"
            )
        if os.path.lexists(target / source.relative_to(root)):
            raise OutputError(f"{target / source.relative_to(root)}: already exists; choose another folder")
    written = []
    for source in sources:
        path = target / source.relative_to(root)
        make_folder(path.parent)
        with atomic_path(path) as temporary:
            shutil.copyfile(source, temporary)
        written.append(path)
    return written
