"""sarmitsuba: a synthetic aperture radar simulator on Mitsuba 3.

The names below are loaded on first use: importing the package imports neither Mitsuba, Dr.Jit nor matplotlib.
"""

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from sarmitsuba.echo.raw import RawData
    from sarmitsuba.focusing import focus
    from sarmitsuba.image.sar_image import SarImage
    from sarmitsuba.loader.load import load_scene
    from sarmitsuba.loader.plugins import register_plugins
    from sarmitsuba.simulation.raw import simulate

__version__ = "0.1.0"

_HOME = {
    "RawData": "sarmitsuba.echo.raw",
    "SarImage": "sarmitsuba.image.sar_image",
    "focus": "sarmitsuba.focusing",
    "load_scene": "sarmitsuba.loader.load",
    "register_plugins": "sarmitsuba.loader.plugins",
    "simulate": "sarmitsuba.simulation.raw",
}


def __getattr__(name: str) -> Any:
    """Import the home of a public name on first use (PEP 562)."""
    if name not in _HOME:
        raise AttributeError(f"module 'sarmitsuba' has no attribute {name!r}")
    value = globals()[name] = getattr(importlib.import_module(_HOME[name]), name)
    return value


def __dir__() -> list[str]:
    """Public names, loaded or not."""
    return sorted(__all__)


__all__ = ["RawData", "SarImage", "__version__", "focus", "load_scene", "register_plugins", "simulate"]
