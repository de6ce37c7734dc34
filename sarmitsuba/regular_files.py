"""Reading of untrusted files: ordinary files of bounded size only, checked on the opened file."""

import errno
import os
import stat
from pathlib import Path

from sarmitsuba.errors import DataError

# a city of a million buildings; what is larger is cut first
LARGEST = 1 << 30
# bytes that a file may unpack to: what any reader's modules and an empty picture take, and of every byte of the file.
# Complex numbers in text, or compressed tenfold, read in several copies, take 60
_LEAST_UNPACKED = 1 << 28
_UNPACKED_PER_BYTE = 60


def open_regular(path: Path | str, most: int = LARGEST) -> int:
    """Open a regular file for reading and return its descriptor, which the caller closes.

    Parameters
    ----------
    path : links are followed
    most : bytes

    Raises
    ------
    OSError
        It cannot be opened, is a folder, pipe, socket or device, or holds more than ``most`` bytes; ``strerror`` says
        which. A pipe that nobody writes to does not hold the caller up.
    """
    flags = (
        os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_CLOEXEC", 0) | getattr(os, "O_BINARY", 0)
    )
    try:
        handle = os.open(path, flags)
    except ValueError:  # a null character
        raise OSError(errno.EINVAL, "is no name of a file") from None
    try:
        found = os.fstat(handle)
        if not stat.S_ISREG(found.st_mode):
            raise OSError(errno.EINVAL, "is no ordinary file")
        if found.st_size > most:
            raise OSError(
                errno.EFBIG,
                f"its {found.st_size / 1e6:.4g} MB are more than {most / 1e6:.4g} MB; cut out a part",
            )
    except OSError:
        os.close(handle)
        raise
    return handle


def check_regular(path: Path | str, most: int = LARGEST) -> int:
    """Size in bytes of a regular file, for readers that open it themselves; raises as :func:`open_regular`."""
    handle = open_regular(path, most)
    try:
        return os.fstat(handle).st_size
    finally:
        os.close(handle)


def read_bytes(path: Path | str, most: int = LARGEST) -> bytes:
    """Content of a regular file; raises as :func:`open_regular`."""
    with os.fdopen(open_regular(path, most), "rb") as file:
        size = os.fstat(file.fileno()).st_size
        content = file.read(size + 1)
    if len(content) > size:
        raise OSError(errno.EBUSY, "grew while it was read; try again")
    return content


def read_text(path: Path | str, *, errors: str = "replace", most: int = LARGEST) -> str:
    """Text of a regular file in UTF-8, any line ends as newlines; raises as :func:`open_regular`.

    Raises
    ------
    UnicodeDecodeError
        ``errors`` is ``strict`` and the text is not UTF-8.
    """
    text = read_bytes(path, most).decode("utf-8", errors)
    return text.replace("\r\n", "\n").replace("\r", "\n")


def most_unpacked(size: int) -> int:
    """Bytes that a file of ``size`` bytes may take in memory, with whatever is compressed in it unpacked."""
    return _LEAST_UNPACKED + _UNPACKED_PER_BYTE * size


def check_unpacked(claimed: int, size: int, most: int | None = None) -> None:
    """Compare what a file's headers claim with its size, before any of it is unpacked.

    Parameters
    ----------
    claimed : bytes that it unpacks to
    size : bytes of the file
    most : bound in bytes; default :func:`most_unpacked`

    Raises
    ------
    DataError
        It claims more.
    """
    most = most_unpacked(size) if most is None else most
    if claimed > most:
        raise DataError(
            f"the file of {size} bytes claims to unpack to {claimed / 1e6:.6g} MB, at most {most / 1e6:.4g} MB are "
            "taken; it is damaged or a trap"
        )


def is_inside(name: str | Path, folder: Path) -> bool:
    """Whether a path, relative to the folder or absolute, ends in it after all links are followed."""
    try:
        place = os.path.realpath(folder / name)
    except (OSError, ValueError):  # longer than the system takes, or with a null character
        return ".." not in Path(name).parts and not Path(name).is_absolute()
    return Path(place).is_relative_to(os.path.realpath(folder))
