"""sarmitsuba: a synthetic aperture radar simulator on Mitsuba 3.

The names below are loaded on first use: importing the package imports neither Mitsuba, Dr.Jit nor matplotlib.
"""

import importlib
import sys
from types import ModuleType
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from sarmitsuba.echo.raw import RawData
    from sarmitsuba.focus import focus
    from sarmitsuba.image.sar_image import SarImage
    from sarmitsuba.scene.loader import load_scene
    from sarmitsuba.scene.plugins import register_plugins
    from sarmitsuba.simulate import simulate

__version__ = "0.1.0"

_HOME = {
    "RawData": "sarmitsuba.echo.raw",
    "SarImage": "sarmitsuba.image.sar_image",
    "focus": "sarmitsuba.focus",
    "load_scene": "sarmitsuba.scene.loader",
    "register_plugins": "sarmitsuba.scene.plugins",
    "simulate": "sarmitsuba.simulate",
}


_VERBS = ("focus", "simulate")  # public functions that share their name with the module they live in


class _Verb(ModuleType):
    """A module that can be called like the function of its own name, so that import order does not matter."""

    def __call__(self, *args: Any, **kwargs: Any) -> Any:
        """Call the function."""
        return getattr(self, self.__name__.rpartition(".")[2])(*args, **kwargs)


class _Package(ModuleType):
    """The package itself: makes the verbs' modules callable when the import system binds them."""

    def __setattr__(self, name: str, value: Any) -> None:
        """Bind a name."""
        if name in _VERBS and type(value) is ModuleType:
            value.__class__ = _Verb
        super().__setattr__(name, value)


def __getattr__(name: str) -> Any:
    """Import the home of a public name on first use (PEP 562)."""
    if name not in _HOME:
        raise AttributeError(f"module 'sarmitsuba' has no attribute {name!r}")
    module = importlib.import_module(_HOME[name])
    return module if name in _VERBS else getattr(module, name)


def __dir__() -> list[str]:
    """Public names, loaded or not."""
    return sorted({*globals(), *_HOME})


sys.modules[__name__].__class__ = _Package

__all__ = ["RawData", "SarImage", "__version__", "focus", "load_scene", "register_plugins", "simulate"]
