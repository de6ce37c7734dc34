"""sarmitsuba: a synthetic aperture radar simulator on Mitsuba 3.

The names below are loaded on first use: importing the package imports neither Mitsuba, Dr.Jit nor matplotlib.
"""

import importlib
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


def __getattr__(name: str) -> Any:
    """Import the home of a public name on first use (PEP 562)."""
    if name not in _HOME:
        raise AttributeError(f"module 'sarmitsuba' has no attribute {name!r}")
    value = getattr(importlib.import_module(_HOME[name]), name)
    globals()[name] = value  # also replaces the sub-modules "focus" and "simulate", which carry the same name
    return value


def __dir__() -> list[str]:
    """Public names, loaded or not."""
    return sorted({*globals(), *_HOME})


__all__ = ["RawData", "SarImage", "__version__", "focus", "load_scene", "register_plugins", "simulate"]
