"""Reading of untrusted files: regular files of bounded size only, checked on the opened file."""

import errno
import os
import stat
from collections.abc import Collection, Mapping
from itertools import islice
from pathlib import Path

from sarmitsuba.core.errors import DataError, OutputError, SarmitsubaError
from sarmitsuba.core.parameters import did_you_mean, one_line

# a city of a million buildings; larger files must be divided
LARGEST = 1 << 30
# bytes that a file may unpack to: for the modules of a reader and an empty picture, and per byte of the file: complex
# numbers in text, or compressed tenfold, read in several copies, take 60
_LEAST_UNPACKED = 1 << 28
_UNPACKED_PER_BYTE = 60


def check_text(name: Path | str, error: type[SarmitsubaError] = OutputError) -> None:
    """Raise an error for a name that is not UTF-8, which some libraries cannot open or write to."""
    try:
        str(name).encode()
    except UnicodeEncodeError:
        shown = str(name).encode(errors="surrogateescape")
        raise error(f"{shown!r}: the name is not UTF-8 text; rename the file or folder") from None


# names of a folder that are compared with a missing one
_COMPARED = 2000


def name_hint(path: Path) -> str:
    """``; did you mean "..."?`` when its folder has a file of a name close to a missing one's, else empty."""
    try:
        with os.scandir(path.parent) as entries:
            beside = [entry.name for entry in islice(entries, _COMPARED)]
    except (OSError, ValueError):
        return ""
    guess = did_you_mean(path.name, sorted(beside))
    return "" if f'"{path.name}"' in guess else guess


def open_regular(path: Path | str, most: int = LARGEST) -> int:
    """Open a regular file for reading and return its descriptor, which the caller closes.

    Parameters
    ----------
    path : links are followed
    most : bytes

    Raises
    ------
    OSError
        It cannot be opened, is a folder, pipe, socket or device, or holds more than ``most`` bytes; ``strerror`` states
        the reason. An idle pipe does not block the caller.
    """
    flags = (
        os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_CLOEXEC", 0) | getattr(os, "O_BINARY", 0)
    )
    try:
        handle = os.open(path, flags)
    except ValueError:  # a null character
        raise OSError(errno.EINVAL, "is not a file name") from None
    try:
        found = os.fstat(handle)
        if not stat.S_ISREG(found.st_mode):
            raise OSError(errno.EINVAL, "is not a regular file")
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
        raise OSError(errno.EBUSY, "grew during reading; try again")
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


def read_rows(
    path: Path | str,
    what: str,
    texts: Collection[str],
    numbers: Mapping[str, float | None],
    error: type[SarmitsubaError],
) -> list[dict[str, str | float]]:
    """Rows of a CSV file whose first line names its columns, in any order; ``#`` begins a comment.

    Parameters
    ----------
    path, what : of the file, and what it holds, for messages
    texts : names of columns of text, all needed
    numbers : defaults of the columns of finite numbers; None: the column is needed
    error : class of the errors

    Raises
    ------
    ``error`` with one line: the file cannot be read, or a column or cell is missing, unknown or no number
    """
    try:
        text = read_text(path, errors="strict")
    except (OSError, UnicodeDecodeError) as failure:
        reason = getattr(failure, "strerror", None) or failure
        raise error(f"{path}: cannot read {what}: {reason}") from failure
    lines = [[cell.strip() for cell in line.partition("#")[0].split(",")] for line in text.splitlines()]
    named = [(number, cells) for number, cells in enumerate(lines, 1) if cells != [""]]
    header = named[0][1] if named else []
    known = [*texts, *numbers]
    needed = [*texts, *(name for name, default in numbers.items() if default is None)]
    for name in header:
        if name not in known or header.count(name) > 1:
            raise error(
                f'{path}: column "{one_line(name)}"{did_you_mean(name, known)}; there are {", ".join(known)}'
            )
    if missing := [name for name in needed if name not in header]:
        raise error(f"{path}: no column {missing[0]}; the first line names the columns: {', '.join(needed)}")
    rows: list[dict[str, str | float]] = []
    for number, cells in named[1:]:
        row: dict[str, str | float] = {k: v for k, v in numbers.items() if v is not None}
        try:
            for name, cell in zip(header, cells, strict=True):
                row[name] = cell if name in texts else float(cell)
        except ValueError:
            raise error(
                f'{path}:{number}: "{one_line(",".join(cells))}" is not {", ".join(header)}'
            ) from None
        if not all(isinstance(value, str) or abs(value) < 1e300 for value in row.values()):
            raise error(f"{path}:{number}: holds a number that is not finite")
        rows.append(row)
    if not rows:
        raise error(f"{path}: {what} has no rows below its header")
    return rows


def most_unpacked(size: int) -> int:
    """Largest unpacked size of a file of ``size`` bytes, bytes."""
    return _LEAST_UNPACKED + _UNPACKED_PER_BYTE * size


def check_unpacked(claimed: int, size: int, most: int | None = None) -> None:
    """Check the unpacked size stated in a file's headers before unpacking.

    Parameters
    ----------
    claimed : stated unpacked size, bytes
    size : bytes of the file
    most : bound in bytes; default :func:`most_unpacked`

    Raises
    ------
    DataError
        The stated size is larger.
    """
    most = most_unpacked(size) if most is None else most
    if claimed > most:
        raise DataError(
            f"the file of {size} bytes claims to unpack to {claimed / 1e6:.6g} MB, above the limit of "
            f"{most / 1e6:.4g} MB; it is damaged or malicious"
        )


def describe_missing(path: Path | str, missing: str = "no such file or folder") -> str:
    """Why a path does not exist, for an error message: it is ``missing``, or is a link whose target is."""
    if os.path.islink(path):
        return "is a link to a file that does not exist"
    return f"{missing}{name_hint(Path(path))}"


def is_inside(name: str | Path, folder: Path) -> bool:
    """Whether a path, relative to the folder or absolute, is inside it after following all links."""
    try:
        place = os.path.realpath(folder / name)
    except (OSError, ValueError):  # longer than the system allows, or with a null character
        return ".." not in Path(name).parts and not Path(name).is_absolute()
    return Path(place).is_relative_to(os.path.realpath(folder))
