"""The output folder of ``render`` and ``focus``: what the program wrote there is replaced, nothing else is touched."""

import os
import re
import shutil
import stat
import warnings
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

from sarmitsuba.errors import OutputError, SarmitsubaWarning
from sarmitsuba.io import parameters
from sarmitsuba.io.atomic import make_folder
from sarmitsuba.io.encoding import json_value
from sarmitsuba.io.locking import sole_writer
from sarmitsuba.parameters import one_line
from sarmitsuba.regular_files import read_text

MANIFEST = ".sarmitsuba.json"
_ON_THE_WAY = (
    -1
)  # bytes in the list of a file that is being written: it may be the old one, the new one or none
# files that commands write: no list, whoever made it, can call another one the program's own
_WRITTEN = re.compile(
    r"(raw|image|second_on_first|quicklook|focusers|page|parameters|passes|quality|interferogram|heights|rcs|"
    r"polarimetry|pauli|h_a_alpha|h_alpha_plane|m_chi|m_delta)"
    r"(_[A-Za-z0-9]+)*(\.[A-Za-z0-9]+)+"
)
_LARGEST_LIST = 1_000_000  # bytes


class OutputFolder:
    """A folder, and the list of what the program wrote into it.

    The list is a file of the folder: names with their bytes, and a mark of what was simulated. A file of another size,
    one that is not in the list, and whatever is no plain file of the folder (a link, a file elsewhere) is the user's
    own. So is every name that no command writes: a list may come from anybody.

    Parameters
    ----------
    path : the folder, which exists

    Attributes
    ----------
    mark : of the scene and settings whose results lie here or, where there are none, come here
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.mark = ""
        self._bytes: dict[str, int] = {}
        try:
            if (path / MANIFEST).is_symlink():
                raise ValueError
            record = json_value(read_text(path / MANIFEST, errors="strict", most=_LARGEST_LIST))
            listed = {str(name): int(size) for name, size in record["files"].items()}
            self.mark = str(record["mark"])
        except FileNotFoundError:
            pass
        except (OSError, ArithmeticError, ValueError, TypeError, KeyError, AttributeError) as error:
            raise OutputError(
                f"{path / MANIFEST}: the list of written files cannot be read; remove it, or choose another -o"
            ) from error
        else:
            self._bytes = {name: size for name, size in listed.items() if _WRITTEN.fullmatch(name)}
            strange = [one_line(name) for name in listed if name not in self._bytes]
            if strange:
                others = f" and {len(strange) - 1} more" if len(strange) > 1 else ""
                warnings.warn(
                    f"{path / MANIFEST}: lists {strange[0]!r}{others}, which no command writes; the entry is ignored",
                    SarmitsubaWarning,
                    stacklevel=2,
                )

    def owns(self, name: str) -> bool:
        """Whether the program wrote that file, as it is now."""
        path = self.path / name
        return _is_plain(path) and self._bytes.get(name) in (_ON_THE_WAY, path.stat().st_size)

    def check(self, mark: str, names: Iterable[str], *, force: bool) -> None:
        """Ask whether results may be written, before any work goes into them.

        Parameters
        ----------
        mark : of the scene and settings
        names : of the files that will be written
        force : replace results of another mark

        Raises
        ------
        OutputError
            The folder holds results of something else and ``force`` is off, or a file of the user's own is in the way.
        """
        for name in names:
            self._check_own(name)
        results = any(self.owns(name) for name in self._bytes)
        if not results:
            self.mark = mark
        if mark != self.mark and not force:
            raise OutputError(
                f"{self.path}: holds results of another scene, of other settings or of another version of the program; "
                "choose another -o, or use --force to replace them"
            )

    def check_space(self, needed: float) -> None:
        """Raise an OutputError where so many bytes do not fit, what they replace left aside."""
        free = shutil.disk_usage(self.path).free + sum(
            (self.path / name).stat().st_size for name in self._bytes if self.owns(name)
        )
        if needed > free:
            raise OutputError(
                f"{self.path}: the results take at least {needed / 1e9:.3g} GB and {free / 1e9:.3g} GB are free; free "
                "some, choose another -o, or ask for less (image extents, pulses, --no-error-bars)"
            )

    def clear(self, mark: str, keep: Iterable[Path] = ()) -> None:
        """Remove what the program wrote, so that old and new results never stand side by side.

        Parameters
        ----------
        mark : of the scene and settings whose results come now
        keep : files that stay
        """
        kept = [path for path in keep if path.exists()]
        for name in tuple(self._bytes):
            path = self.path / name
            if self.owns(name) and any(path.samefile(other) for other in kept):
                continue
            if self.owns(name):
                path.unlink()
            del self._bytes[name]
        self.mark = mark
        self._save()

    def enter(self, name: str) -> None:
        """List a file that the program wrote, as it is now; one that is not there is left out."""
        path = self.path / name
        if _is_plain(path):
            self._bytes[name] = path.stat().st_size
            self._save()
        elif self._bytes.pop(name, None) is not None:
            self._save()

    def announce(self, name: str) -> None:
        """List a file that will be written, so that it is the program's own whenever the process is killed."""
        if not _WRITTEN.fullmatch(name):
            raise ValueError(f"{name}: no name of a result")
        self._bytes[name] = _ON_THE_WAY
        self._save()

    @contextmanager
    def writing(self, name: str) -> Iterator[Path]:
        """Path of a file that the block writes; it is listed when the block ends, however it ends.

        Raises
        ------
        OutputError
            A file of the user's own has that name.
        """
        self._check_own(name)
        path = self.path / name
        self.announce(name)
        try:
            yield path
        finally:
            self.enter(name)

    def _check_own(self, name: str) -> None:
        if os.path.lexists(self.path / name) and not self.owns(name):
            raise OutputError(
                f"{self.path / name}: this file is not one that the program wrote here, and would be lost; move it, "
                "or choose another -o"
            )

    def _save(self) -> None:
        if not self._bytes:
            (self.path / MANIFEST).unlink(missing_ok=True)
            return
        parameters.write(self.path / MANIFEST, {"mark": self.mark, "files": self._bytes})


def _is_plain(path: Path) -> bool:
    """Whether there is a file of the folder's own: no link, folder or device."""
    try:
        return stat.S_ISREG(path.lstat().st_mode)
    except OSError:
        return False


@contextmanager
def output_folder(path: str) -> Iterator[OutputFolder]:
    """Yield the folder. It is made if needed, and removed again if nothing was put into it.

    Raises
    ------
    OutputError
        It is a file, it cannot be made or written to, or another run is writing into it.
    """
    folder = Path(path)
    if folder.exists() and not folder.is_dir():
        raise OutputError(f"{folder}: this is a file, not a folder; choose another -o")
    existed = folder.is_dir()
    make_folder(folder)
    probe = folder / ".sarmitsuba.part"
    try:
        probe.unlink(missing_ok=True)
        probe.touch(exist_ok=False)  # never through a link
        probe.unlink()
    except OSError as error:
        raise OutputError(
            f"{folder}: cannot write into this folder: {error.strerror}; choose another -o"
        ) from error
    try:
        with sole_writer(folder):
            yield OutputFolder(folder)
    finally:
        if not existed and not any(folder.iterdir()):
            folder.rmdir()


__all__ = ["MANIFEST", "OutputFolder", "output_folder"]
