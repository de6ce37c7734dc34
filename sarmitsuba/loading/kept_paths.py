"""Files named in the record of a run, so that the record holds from every working folder."""

import os
from pathlib import Path

from sarmitsuba.loading.library import scenes_dir


def kept_path(file: Path | str, folder: Path | str) -> str:
    """Text for a file in a run's record: bare name of a shipped scene or radar, else path from the run's folder."""
    path = Path(os.path.realpath(file))
    shipped = Path(os.path.realpath(scenes_dir()))
    if path.suffix == ".xml" and path.parent in (shipped, shipped / "radars"):
        return path.stem
    try:
        text = Path(os.path.relpath(path, os.path.realpath(folder))).as_posix()
    except ValueError:  # another drive
        return str(path)
    return text if "/" in text else f"./{text}"


def found_path(text: str, folder: Path | str, *, radar: bool = False) -> Path:
    """File of a record in ``folder``, which need not exist; see :func:`kept_path`."""
    if "/" not in text and not Path(text).suffix:
        return scenes_dir() / ("radars" if radar else "") / f"{text}.xml"
    return Path(os.path.normpath(Path(folder) / text))
