"""Folder of Dr.Jit's compiled kernels: in the home folder, or another one if that is not writable."""

import os
import stat
import tempfile
import warnings
from pathlib import Path

from sarmitsuba.core.errors import SarmitsubaWarning

CACHE_VARIABLE = "DRJIT_CACHE_DIR"


def prepare_kernel_cache() -> Path | None:
    """Choose another folder for compiled kernels if Dr.Jit's own is unusable; call before importing Dr.Jit.

    A folder named by ``DRJIT_CACHE_DIR`` is not changed. A ``~/.drjit`` that is not writable, is a link, or is owned or
    writable by others is replaced by a private folder of this user among the temporary files, which is kept from run to
    run; a folder that others could have filled is not used, because kernels are code.

    Returns
    -------
    the folder; None: no choice was needed

    Warns
    -----
    SarmitsubaWarning
        Once, with the chosen folder.
    """
    if os.environ.get(CACHE_VARIABLE) or os.name != "posix":
        return None
    home = os.environ.get("HOME", "")
    usual = Path(home) / ".drjit"
    reason = (
        ""
        if home and _own(usual) and _writable(usual)
        else _reason(usual)
        if home
        else "there is no home folder"
    )
    if not reason:
        return None
    folder = Path(tempfile.gettempdir()) / f"sarmitsuba-kernels-{os.getuid()}"
    if not _own(folder):
        folder = Path(tempfile.mkdtemp(prefix="sarmitsuba-kernels-"))
    os.environ[CACHE_VARIABLE] = str(folder)
    warnings.warn(
        f"compiled kernels are kept in {folder}, because {reason}; set {CACHE_VARIABLE} for another place",
        SarmitsubaWarning,
        stacklevel=2,
    )
    return folder


def _writable(folder: Path) -> bool:
    """Whether files can be created in the folder, which is created if needed."""
    try:
        folder.mkdir(exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            return True
    except OSError:
        return False


def _reason(folder: Path) -> str:
    """Reason why a folder cannot be used."""
    try:
        found = folder.lstat()
    except OSError:
        return f"{folder.parent} cannot be written"
    if not stat.S_ISDIR(found.st_mode):
        return f"{folder} is no folder"
    if not _private(found):
        return f"others can write in {folder} (chmod go-w it)"
    return f"{folder} cannot be written"


def _own(folder: Path) -> bool:
    """Whether the folder, created if needed, is private to this user and no link."""
    try:
        folder.mkdir(mode=0o700, exist_ok=True)
        found = folder.lstat()
    except OSError:
        return False
    return stat.S_ISDIR(found.st_mode) and _private(found)


def _private(found: os.stat_result) -> bool:
    """Whether a folder is owned and writable by this user only; a group of the user's number counts as the user."""
    others = stat.S_IWOTH if found.st_gid == found.st_uid else stat.S_IWOTH | stat.S_IWGRP
    return found.st_uid == os.getuid() and not found.st_mode & others
