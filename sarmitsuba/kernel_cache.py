"""Where Dr.Jit keeps compiled kernels: in the home folder, or elsewhere where that cannot be written."""

import os
import stat
import tempfile
import warnings
from pathlib import Path

from sarmitsuba.errors import SarmitsubaWarning

CACHE_VARIABLE = "DRJIT_CACHE_DIR"


def prepare_kernel_cache() -> Path | None:
    """Choose another folder for compiled kernels where Dr.Jit could not write its own; before it is imported.

    A folder that ``DRJIT_CACHE_DIR`` names is left alone. In place of ``~/.drjit`` it is one of this user's own in the
    folder for temporary files, which is kept from run to run; one that others could have filled is not used, because
    kernels are code.

    Returns
    -------
    the folder, or None where nothing had to be chosen

    Warns
    -----
    SarmitsubaWarning
        Once: which folder it is.
    """
    if os.environ.get(CACHE_VARIABLE) or os.name != "posix":
        return None
    home = os.environ.get("HOME", "")
    if home and _writable(Path(home) / ".drjit"):
        return None
    folder = Path(tempfile.gettempdir()) / f"sarmitsuba-kernels-{os.getuid()}"
    if not _own(folder):
        folder = Path(tempfile.mkdtemp(prefix="sarmitsuba-kernels-"))
    os.environ[CACHE_VARIABLE] = str(folder)
    warnings.warn(
        f"compiled kernels are kept in {folder}, because {home or 'no home folder'} cannot be written; set "
        f"{CACHE_VARIABLE} for another place",
        SarmitsubaWarning,
        stacklevel=2,
    )
    return folder


def _writable(folder: Path) -> bool:
    """Whether files can be made in the folder, which is made if need be."""
    try:
        folder.mkdir(exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            return True
    except OSError:
        return False


def _own(folder: Path) -> bool:
    """Whether the folder, made if need be, is this user's, no link, and nobody else can write in it."""
    try:
        folder.mkdir(mode=0o700, exist_ok=True)
        found = folder.lstat()
    except OSError:
        return False
    return stat.S_ISDIR(found.st_mode) and found.st_uid == os.getuid() and not found.st_mode & 0o022


__all__ = ["CACHE_VARIABLE", "prepare_kernel_cache"]
