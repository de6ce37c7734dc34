"""Registries of laws, modes, focusers, effects, formats ... by name.

An entry is any object with a ``name``. Built-in entries are modules of one folder, or of one name in many folders,
imported at the first look-up; a new entry is one new file there. A user's module registers its entries when it is
imported: in Python by ``import``, on the command line by ``--extension``, if installed by an entry point of the group
``sarmitsuba.extensions``.
"""

import functools
import importlib
import importlib.metadata
import importlib.util
import os
import pkgutil
import sys
import threading
import traceback
from collections.abc import Callable, Iterator
from pathlib import Path
from types import TracebackType
from typing import Generic, Protocol, TypeVar

from sarmitsuba.core.errors import ExtensionError, SarmitsubaError
from sarmitsuba.core.parameters import did_you_mean

ENTRY_POINTS = "sarmitsuba.extensions"


def late(module: str, name: str) -> Callable[..., object]:
    """Function of a module in a higher layer, imported on use.

    For methods of results that call a higher layer, such as ``SarImage.plot``: importing the image layer then imports
    no Matplotlib.
    """
    function: Callable[..., object] = getattr(importlib.import_module(module), name)
    return function


@functools.cache
def _list_installed() -> tuple[str, ...]:
    """Modules of installed extensions; looking through all packages takes longer than importing a registry."""
    return tuple(point.value for point in importlib.metadata.entry_points(group=ENTRY_POINTS))


def png_of(figure: object) -> bytes:
    """PNG of a figure of the view layer, for results that show themselves in notebooks."""
    png = getattr(figure, "_repr_png_")()  # noqa: B009 - the layer below knows no figure
    assert isinstance(png, bytes)
    return png


Value = TypeVar("Value")


class _ForeignCode:
    """Context that runs a user's code: its errors become an ExtensionError of one line."""

    def __enter__(self) -> None:
        pass

    def __exit__(
        self, _: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if not isinstance(error, Exception | SystemExit) or isinstance(error, SarmitsubaError):
            return
        line = self._line(error, trace)
        if line is not None:
            raise ExtensionError(line) from error

    def _line(self, error: BaseException, trace: TracebackType | None) -> str | None:
        """Message for an error; None: it passes as it is."""
        raise NotImplementedError


class Calling(_ForeignCode):
    """Context that calls an entry's code: errors of an extension become an ExtensionError in one line that names it.

    Errors of built-in entries are defects of the program and pass as they are.

    Parameters
    ----------
    kind : of the entry, for the message
    entry : registered
    method : that is called
    """

    def __init__(self, kind: str, entry: object, method: str) -> None:
        self.kind, self.entry, self.method = kind, entry, method

    def _line(self, error: BaseException, trace: TracebackType | None) -> str | None:
        """Entry, method and error; None for a built-in entry."""
        if is_built_in(self.entry):
            return None
        module = sys.modules.get(type(self.entry).__module__)
        said = _describe_error(error, trace, getattr(module, "__file__", None) or "")
        name = getattr(self.entry, "name", type(self.entry).__name__)
        return f"{self.kind} {name!r}: {self.method}: {said}"


def _describe_error(error: BaseException, trace: TracebackType | None, file: str) -> str:
    """Type and text of an error, with the last line of a file that it passed through."""
    own = os.path.abspath(file)
    lines = [frame.lineno for frame in traceback.extract_tb(trace) if os.path.abspath(frame.filename) == own]
    place = f" ({os.path.basename(own)}, line {lines[-1]})" if lines else ""
    text = " ".join(str(error).split()) or "no text"
    return f"{type(error).__name__}: {text}{place}"


def checked_type(found: Value, *kinds: type) -> Value:
    """Result of an entry's method, if it is of one of these types.

    Raises
    ------
    TypeError
        It is not.
    """
    if not isinstance(found, kinds):
        raise TypeError(f"returns {type(found).__name__}, not {kinds[0].__name__}")
    return found


def is_built_in(entry: object) -> bool:
    """Whether a registered entry comes with the program."""
    return type(entry).__module__.startswith("sarmitsuba.")


class Named(Protocol):
    """Interface of an entry of a registry."""

    @property
    def name(self) -> str:
        """Name in the user's input."""


T = TypeVar("T", bound=Named)


class Registry(Generic[T]):
    """Registry of the entries of one kind by name.

    Parameters
    ----------
    kind : of the entries, for messages, e.g. ``diffuse law``
    interface : class of the entries
    packages : dotted names of the folders of built-in entries, imported at the first look-up; ``a.*.b`` stands for the
        module ``b`` of every folder in ``a`` that has one
    """

    def __init__(self, kind: str, interface: type, *packages: str) -> None:
        self.kind, self.interface = kind, interface
        self._packages = packages
        self._entries: dict[str, T] = {}
        self._owners: dict[str, str] = {}
        self._loaded = not packages
        self._loading = threading.RLock()  # other threads wait; modules being loaded may look up entries
        self._in_work = False
        if hasattr(os, "register_at_fork"):
            os.register_at_fork(after_in_child=self._renew)

    def _renew(self) -> None:
        """Begin anew in a forked process, which another thread that was loading does not reach."""
        self._loading, self._in_work = threading.RLock(), False

    def register(self, entry: T) -> T:
        """Add an entry and return it.

        Raises
        ------
        ExtensionError
            It is of another class, or its name is used by another module or is not one word.
        """
        if not isinstance(entry, self.interface):
            wanted = self.interface.__name__
            found = "a class" if isinstance(entry, type) else f"an object of {type(entry).__name__}"
            raise ExtensionError(
                f"{self.kind}: {found} is registered; give an object of (a subclass of) {wanted}"
            )
        name = getattr(entry, "name", None)
        if not isinstance(name, str) or not name.replace("-", "_").replace(":", "_").isidentifier():
            raise ExtensionError(f"{self.kind} {name!r}: the name must be a word of letters, digits and _")
        owner = sys._getframe(1).f_globals.get("__name__", "")  # a module executed again replaces its entry
        if self._owners.setdefault(name, owner) != owner:
            raise ExtensionError(f"{self.kind} {name!r} is already registered by {self._owners[name]}")
        self._entries[name] = entry
        return entry

    def __getitem__(self, name: str) -> T:
        """Entry of that name.

        Raises
        ------
        ExtensionError
            Unknown name; the message lists the known ones.
        """
        self._load()
        try:
            return self._entries[name]
        except KeyError:
            raise ExtensionError(
                f"{self.kind} {name!r} is unknown{did_you_mean(name, self._entries)}; choose one of "
                f"{', '.join(self._entries)}"
            ) from None

    def __contains__(self, name: object) -> bool:
        self._load()
        return name in self._entries

    def __iter__(self) -> Iterator[T]:
        self._load()
        return iter(tuple(self._entries.values()))

    @property
    def names(self) -> tuple[str, ...]:
        """All names, in order of registration."""
        self._load()
        return tuple(self._entries)

    @property
    def own_names(self) -> tuple[str, ...]:
        """Names of built-in entries."""
        return tuple(name for name in self.names if self._owners[name].startswith("sarmitsuba."))

    def _load(self) -> None:
        if self._loaded:
            return
        with self._loading:
            if self._loaded or self._in_work:
                return
            self._in_work = True
            try:
                found = (name for package in self._packages for name in _modules_in(package))
                for module_name in (*found, *_list_installed()):
                    importlib.import_module(module_name)
                self._loaded = True
            finally:
                self._in_work = False


def _modules_in(package: str) -> Iterator[str]:
    """Dotted names of the modules of a folder, or for ``a.*.b`` of ``a.FOLDER.b`` of every folder that has it."""
    folder, star, wanted = package.partition(".*.")
    for module in pkgutil.iter_modules(importlib.import_module(folder).__path__):
        name = f"{folder}.{module.name}"
        if not star:
            yield name
        elif module.ispkg:
            yield from (inside for inside in _modules_in(name) if inside == f"{name}.{wanted}")


def load_extension(module_or_file: str, *, again: bool = True) -> None:
    """Import a user's module, which registers its entries.

    Parameters
    ----------
    module_or_file : dotted name of an importable module, or path of a ``.py`` file
    again : whether to import a file again if one of its name was imported before

    Raises
    ------
    ExtensionError
        It cannot be found or imported.
    """
    path = Path(module_or_file)
    with _Importing(module_or_file):
        if path.suffix != ".py":
            importlib.import_module(module_or_file)
            return
        if not os.path.isfile(path):
            beside = [str(each) for each in sorted(path.parent.glob("*.py"))]
            guess = did_you_mean(str(path), beside) or "; check the path"
            raise ExtensionError(f"{path}: no such extension file{guess}")
        name = f"sarmitsuba_extension_{path.stem}"
        if not again and name in sys.modules:
            return
        spec = importlib.util.spec_from_file_location(name, path)
        assert spec is not None and spec.loader is not None
        module = importlib.util.module_from_spec(spec)
        sys.modules[name] = module
        spec.loader.exec_module(module)


class _Importing(_ForeignCode):
    """Context that imports a user's module: its errors become an ExtensionError in one line that names it."""

    def __init__(self, module_or_file: str) -> None:
        self.module_or_file = module_or_file

    def _line(self, error: BaseException, trace: TracebackType | None) -> str:
        """Module and error."""
        expected = isinstance(error, ImportError | SyntaxError)
        said = str(error) if expected else _describe_error(error, trace, self.module_or_file)
        if isinstance(error, ModuleNotFoundError) and error.name == self.module_or_file:
            said += did_you_mean(error.name, (module.name for module in pkgutil.iter_modules()))
        return f"{self.module_or_file}: cannot be imported: {said}"
