"""Shipped scenes and radars, found by bare name."""

import os
import re
import warnings
from dataclasses import dataclass
from pathlib import Path

from sarmitsuba.core.errors import SarmitsubaWarning, SceneError
from sarmitsuba.core.parameters import did_you_mean
from sarmitsuba.machine.regular_files import check_text, describe_missing, name_hint

_COMMENT = re.compile(r"<!--(.*?)-->", re.DOTALL)


@dataclass(frozen=True)
class LibraryEntry:
    """One shipped file.

    Parameters
    ----------
    name : bare name that the command line and ``load_scene`` take
    title : first line of the comment that opens the file
    description : rest of that comment, lines as written, without indentation
    path : the file
    """

    name: str
    title: str
    description: str
    path: Path


def scenes_dir() -> Path:
    """Return the folder of the shipped scenes: inside an installed package, beside it in a checkout."""
    package = Path(__file__).resolve().parents[1]
    inside = package / "_scenes"
    beside = package.parent / "scenes"
    folder = inside if os.path.isdir(inside) else beside
    if not os.path.isdir(folder):
        raise SceneError(f"{beside}: the shipped scenes are missing; install the package again")
    return folder


def list_scenes() -> tuple[LibraryEntry, ...]:
    """Return the shipped scenes in order of their names."""
    return _entries(scenes_dir())


def list_radars() -> tuple[LibraryEntry, ...]:
    """Return the shipped radar descriptions (sensor, film, integrator) in order of their names."""
    return _entries(scenes_dir() / "radars")


def resolve(name_or_path: str | Path) -> Path:
    """Return the file of a scene: a path, or the bare name of a shipped scene.

    An existing file has precedence over a shipped scene of the same name, with or without its suffix ``.xml``; a folder
    of that name, such as one of results, has not.

    Raises
    ------
    SceneError
        There is neither such a file nor such a scene; the message lists the names and the closest.

    Warns
    -----
    SarmitsubaWarning
        A file in the working folder hides the shipped one of that bare name.
    """
    return _resolve(name_or_path, scenes_dir(), "scene")


def resolve_radar(name_or_path: str | Path) -> Path:
    """Return the file of a radar description: a path, or the bare name of a shipped one; see `resolve`."""
    return _resolve(name_or_path, scenes_dir() / "radars", "radar")


def shipped_radar(name: str) -> str:
    """Remedy for a file that is missing and is called like a shipped radar; empty for other names."""
    stem = Path(name).stem
    if Path(name).suffix != ".xml" or stem not in {entry.name for entry in list_radars()}:
        return ""
    return f'leave it out and give the shipped radar by --radar {stem} (radar="{stem}")'


def _entries(folder: Path) -> tuple[LibraryEntry, ...]:
    found = []
    for path in sorted(folder.glob("*.xml")):
        match = _COMMENT.search(path.read_text(encoding="utf-8"))
        lines = [line.strip() for line in match.group(1).strip().splitlines()] if match else [path.stem]
        found.append(LibraryEntry(path.stem, lines[0], "\n".join(lines[1:]).strip(), path))
    return tuple(found)


def _resolve(name_or_path: str | Path, folder: Path, what: str) -> Path:
    check_text(name_or_path, SceneError)
    path = Path(name_or_path)
    if os.path.isfile(path):
        return path
    text = str(name_or_path)
    bare = path.name == text and path.suffix in ("", ".xml")
    shipped = folder / f"{path.stem}.xml"
    there = bare and bool(path.stem) and os.path.isfile(shipped)
    own = path.with_name(f"{path.name}.xml") if path.name and not path.suffix else path
    if os.path.isfile(own):
        if there:
            warnings.warn(
                f"{text}: the file {own} in this folder is used, not the shipped {what} of that name",
                SarmitsubaWarning,
                stacklevel=3,
            )
        return own
    if there:
        return shipped
    if os.path.isdir(path):
        raise SceneError(f"{text}: a folder, not a {what} file; name the XML file in it")
    if bare:
        names = sorted(p.stem for p in folder.glob("*.xml"))
        guess = did_you_mean(path.stem, names) or name_hint(path)
        raise SceneError(
            f"{text}: no such file, and no shipped {what} of that name{guess}; shipped: {', '.join(names)}"
        )
    raise SceneError(f"{text}: {describe_missing(path, f'no such {what} file')}; check the path")
