"""Output folders: files written by the program are replaced, other files are never changed.

One process writes into a folder at a time; temporary files of killed writers are removed. ``parameters.json`` records
a run's parameters and results.
"""

import errno
import json
import os
import re
import shutil
import stat
import warnings
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path
from typing import Any

from sarmitsuba.core.errors import OutputError, SarmitsubaWarning
from sarmitsuba.core.parameters import one_line
from sarmitsuba.machine.atomic import atomic_path, make_folder, part_name, process_of_part, removed_if_stopped
from sarmitsuba.machine.encoding import json_value, to_json
from sarmitsuba.machine.regular_files import check_text, read_text

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]


@contextmanager
def sole_writer(folder: Path) -> Iterator[None]:
    """Lock a folder for this process, and remove temporary files of dead processes.

    The operating system releases the lock when the process ends, however it ends, without a lock file.

    Raises
    ------
    OutputError
        Another process holds the lock.

    Notes
    -----
    File systems and systems without such locks (some network drives, Windows) do not detect a second writer.
    """
    if fcntl is None:
        yield
        return
    handle = os.open(folder, os.O_RDONLY)
    try:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            if error.errno in (errno.EWOULDBLOCK, errno.EACCES):
                raise OutputError(
                    f"{folder}: another run is writing into this folder; wait for its end, or choose another -o"
                ) from error
        _sweep(folder)
        yield
    finally:
        os.close(handle)


def _sweep(folder: Path) -> None:
    for path in folder.iterdir():
        process = process_of_part(path.name)
        if process is not None and not _alive(process):
            with suppress(
                OSError
            ):  # folders are not temporary files; files that cannot be removed are harmless
                path.unlink()


def _alive(process: int) -> bool:
    try:
        os.kill(process, 0)  # signal 0 only checks whether the process exists
    except (ProcessLookupError, OverflowError):
        return False
    except OSError:
        return True
    return True


def write(path: Path | str, facts: Mapping[str, object]) -> None:
    """Write the facts as standard JSON (non-finite numbers as text), indented, UTF-8."""
    text = json.dumps(to_json(facts, strict=True), indent=2, ensure_ascii=False, allow_nan=False)
    with atomic_path(path) as temporary:
        temporary.write_text(text + "\n", encoding="utf-8")


def read(path: Path | str) -> dict[str, Any]:
    """Read the facts."""
    facts = json_value(read_text(path, errors="strict"))
    if not isinstance(facts, dict):
        raise ValueError(f"{path}: holds no JSON object")
    return facts


MANIFEST = ".sarmitsuba.json"
_INCOMPLETE = -1  # size in the list of a file being written: it may be old, new or missing
# names written by commands: a manipulated list cannot claim other files
RESULTS = re.compile(
    r"(raw|image|second_on_first|quicklook|focusers|page|parameters|passes|quality|interferogram|heights|rcs|cost|"
    r"accuracy|labels|polarimetry|pauli|h_a_alpha|h_alpha_plane|m_chi|m_delta|fit|residual|derivative|depth)"
    r"(_[A-Za-z0-9]+)*(\.[A-Za-z0-9]+)+"
)
_LARGEST_LIST = 1 << 23  # bytes; an import of ten thousand meshes takes less than one


class OutputFolder:
    """Output folder with the list of files written by the program.

    The list is a file in the folder: names with sizes in bytes, and the run hash. Files of another size, files not in
    the list, and files that are not regular (links) belong to the user; so does every name that no command writes,
    since the list is not trusted.

    Parameters
    ----------
    path : of the existing folder
    written : pattern of the names that commands write into such a folder

    Attributes
    ----------
    run_hash : of the scene and settings of the present or, in an empty folder, the future results
    """

    def __init__(self, path: Path, written: re.Pattern[str] = RESULTS) -> None:
        self.path = path
        self.run_hash = ""
        self._written = written
        self._bytes: dict[str, int] = {}
        try:
            if (path / MANIFEST).is_symlink():
                raise ValueError
            record = json_value(read_text(path / MANIFEST, errors="strict", most=_LARGEST_LIST))
            listed = {str(name): int(size) for name, size in record["files"].items()}
            self.run_hash = str(record["mark"])
        except FileNotFoundError:
            pass
        except (OSError, ArithmeticError, ValueError, TypeError, KeyError, AttributeError) as error:
            raise OutputError(
                f"{path / MANIFEST}: the list of written files cannot be read; remove it, or choose another -o"
            ) from error
        else:
            self._bytes = {name: size for name, size in listed.items() if self._written.fullmatch(name)}
            strange = [one_line(name) for name in listed if name not in self._bytes]
            if strange:
                others = f" and {len(strange) - 1} more" if len(strange) > 1 else ""
                warnings.warn(
                    f"{path / MANIFEST}: lists {strange[0]!r}{others}, which no command writes; ignored",
                    SarmitsubaWarning,
                    stacklevel=2,
                )

    def owns(self, name: str) -> bool:
        """Whether the program wrote that file, and it is unchanged."""
        path = self.path / name
        return _is_plain(path) and self._bytes.get(name) in (_INCOMPLETE, path.stat().st_size)

    @property
    def listed(self) -> tuple[str, ...]:
        """All names in the list, also of missing and changed files."""
        return tuple(self._bytes)

    @property
    def names(self) -> tuple[str, ...]:
        """Unchanged files written by the program."""
        return tuple(name for name in self._bytes if self.owns(name))

    def check_names(self, names: Iterable[str]) -> None:
        """Raise an OutputError where a file of the user has one of the names."""
        for name in names:
            if os.path.lexists(self.path / name) and not self.owns(name):
                raise OutputError(
                    f"{self.path / name}: this file was not written by the program here, and would be lost; move "
                    "it, or choose another -o"
                )

    def adopt(self, names: Iterable[str]) -> None:
        """Treat regular files of these names as written by the program, at the user's request."""
        self.enter(*(name for name in names if _is_plain(self.path / name)))

    def check(self, run_hash: str, names: Iterable[str], *, force: bool) -> None:
        """Check that results may be written, before the run.

        Parameters
        ----------
        run_hash : of the scene and settings
        names : of the files to be written
        force : replace results of another run hash

        Raises
        ------
        OutputError
            The folder holds results of another run and ``force`` is off, or a file of the user would be overwritten.
        """
        self.check_names(names)
        if not self.names:
            self.run_hash = run_hash
        if run_hash != self.run_hash and not force:
            raise OutputError(
                f"{self.path}: holds results of another scene, of other settings or of another version of the program; "
                "choose another -o, or use --force to replace them"
            )

    def check_space(self, needed: float) -> None:
        """Raise an OutputError where the results do not fit on the disk, without counting replaced files."""
        free = shutil.disk_usage(self.path).free + sum(
            (self.path / name).stat().st_size for name in self.names
        )
        if needed > free:
            raise OutputError(
                f"{self.path}: the results take at least {needed / 1e9:.3g} GB and {free / 1e9:.3g} GB are free; free "
                "some, choose another -o, or reduce the results (image extents, pulses, --no-error-bars)"
            )

    def clear(self, run_hash: str, keep: Iterable[Path] = ()) -> None:
        """Remove files written by the program, so that old and new results are never mixed.

        Parameters
        ----------
        run_hash : of the scene and settings of the new results
        keep : files to keep
        """
        kept = [path for path in keep if os.path.exists(path)]
        stay = [name for name in self.names if any((self.path / name).samefile(other) for other in kept)]
        self.run_hash = run_hash
        self.drop([name for name in self._bytes if name not in stay])

    def enter(self, *names: str) -> None:
        """Add written files to the list with their present sizes; missing ones are omitted."""
        for name in names:
            if _is_plain(self.path / name):
                self._bytes[name] = (self.path / name).stat().st_size
            else:
                self._bytes.pop(name, None)
        self._save()

    def announce(self, *names: str) -> None:
        """Add files to the list before they are written, so that they belong to the program if the process is killed.

        Raises
        ------
        OutputError
            A file of the user has that name.
        """
        self.check_names(names)
        for name in names:
            if not self._written.fullmatch(name):
                raise ValueError(f"{name}: not a name of a result")
        self._bytes |= dict.fromkeys(names, _INCOMPLETE)
        self._save()

    def drop(self, names: Iterable[str]) -> None:
        """Remove files written by the program, also from the list; others of these names are kept."""
        for name in names:
            if self.owns(name):
                (self.path / name).unlink()
            self._bytes.pop(name, None)
        self._save()

    @contextmanager
    def writing(self, name: str) -> Iterator[Path]:
        """Path of a file for the block to write; it is listed at the end of the block, also after an error.

        Raises
        ------
        OutputError
            A file of the user has that name.
        """
        path = self.path / name
        self.announce(name)
        try:
            yield path
        finally:
            self.enter(name)

    def _save(self) -> None:
        if not self._bytes:
            (self.path / MANIFEST).unlink(missing_ok=True)
            return
        write(self.path / MANIFEST, {"mark": self.run_hash, "files": self._bytes})


def _is_plain(path: Path) -> bool:
    """Whether a regular file exists: no link, folder or device."""
    try:
        return stat.S_ISREG(path.lstat().st_mode)
    except OSError:
        return False


@contextmanager
def output_folder(path: Path | str, written: re.Pattern[str] = RESULTS) -> Iterator[OutputFolder]:
    """Yield the output folder. It is created if needed, and removed if it stays empty.

    Parameters
    ----------
    path : of the folder
    written : pattern of the names that commands write into such a folder

    Raises
    ------
    OutputError
        It is a file, it cannot be created or written, or another run is writing into it.
    """
    folder = Path(path)
    existed = os.path.isdir(folder)
    if os.path.lexists(folder) and not existed:
        raise OutputError(f"{folder}: this is a file, not a folder; choose another -o")
    make_folder(folder)
    probe = folder / part_name()
    try:
        with removed_if_stopped(partial(probe.unlink, missing_ok=True), probe):
            probe.touch(exist_ok=False)  # never through a link
            probe.unlink()
    except OSError as error:
        raise OutputError(
            f"{folder}: cannot write into this folder: {error.strerror}; choose another -o"
        ) from error

    def remove_empty() -> None:
        if not existed:
            with suppress(OSError):  # not empty
                folder.rmdir()

    with removed_if_stopped(remove_empty, None if existed else folder):
        try:
            with sole_writer(folder):
                yield OutputFolder(folder, written)
        finally:
            remove_empty()


class OutputFile:
    """Output file named by the user: an existing file is replaced only with ``force``.

    A file in the list of its folder stays in that list.

    Parameters
    ----------
    path : of the file
    force : replace an existing file

    Raises
    ------
    OutputError
        The file exists and was not written by the program, and ``force`` is off; or it is a folder.
    """

    def __init__(self, path: Path | str, *, force: bool = False) -> None:
        self.path = Path(path)
        check_text(self.path)
        folder, name = self.path.parent, self.path.name
        is_result = RESULTS.fullmatch(name) and os.path.lexists(folder / MANIFEST)
        self._folder = OutputFolder(folder) if is_result else None
        self._others = os.path.lexists(self.path) and not (self._folder and self._folder.owns(name))
        if os.path.isdir(self.path):
            raise OutputError(f"{self.path}: this is a folder, not a file; choose another -o")
        if self._others and not force:
            raise OutputError(f"{self.path}: already exists; choose another -o, or --force replaces it")

    @contextmanager
    def writing(self) -> Iterator[Path]:
        """Path of the file, for atomic writing by the block."""
        if self._folder is None:
            yield self.path
        elif self._others:
            yield self.path
            self._folder.enter(self.path.name)
        else:
            with self._folder.writing(self.path.name) as path:
                yield path
