"""The output folder of ``render`` and ``focus``: what the program wrote there is replaced, nothing else is touched."""

import json
import shutil
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

from sarmitsuba.errors import OutputError
from sarmitsuba.io import parameters
from sarmitsuba.io.atomic import make_folder
from sarmitsuba.io.locking import sole_writer
from sarmitsuba.regular_files import read_text

MANIFEST = ".sarmitsuba.json"
_ON_THE_WAY = (
    -1
)  # bytes in the list of a file that is being written: it may be the old one, the new one or none


class OutputFolder:
    """A folder, and the list of what the program wrote into it.

    The list is a file of the folder: names with their bytes, and a mark of what was simulated. A file of another size,
    or one that is not in the list, is the user's own.

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
            record = json.loads(read_text(path / MANIFEST, errors="strict"))
            self._bytes = {str(name): int(size) for name, size in record["files"].items()}
            self.mark = str(record["mark"])
        except FileNotFoundError:
            pass
        except (OSError, ValueError, TypeError, KeyError, AttributeError) as error:
            raise OutputError(
                f"{path / MANIFEST}: the list of written files cannot be read; remove it, or choose another -o"
            ) from error

    def owns(self, name: str) -> bool:
        """Whether the program wrote that file, as it is now."""
        path = self.path / name
        return path.is_file() and self._bytes.get(name) in (_ON_THE_WAY, path.stat().st_size)

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
        if path.is_file():
            self._bytes[name] = path.stat().st_size
            self._save()
        elif self._bytes.pop(name, None) is not None:
            self._save()

    def announce(self, name: str) -> None:
        """List a file that will be written, so that it is the program's own whenever the process is killed."""
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
        if (self.path / name).exists() and not self.owns(name):
            raise OutputError(
                f"{self.path / name}: this file is not one that the program wrote here, and would be lost; move it, "
                "or choose another -o"
            )

    def _save(self) -> None:
        if not self._bytes:
            (self.path / MANIFEST).unlink(missing_ok=True)
            return
        parameters.write(self.path / MANIFEST, {"mark": self.mark, "files": self._bytes})


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
        probe.touch()
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
