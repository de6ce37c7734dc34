"""sarmitsuba: a synthetic aperture radar simulator on Mitsuba 3.

The names below are loaded on first use: importing the package imports neither Mitsuba, Dr.Jit nor matplotlib.
"""

import importlib
from typing import TYPE_CHECKING, Any

from sarmitsuba.version import __version__

if TYPE_CHECKING:
    from sarmitsuba.echo.raw import RawData
    from sarmitsuba.focusing import focus
    from sarmitsuba.image.sar_image import SarImage
    from sarmitsuba.loader.build import SceneMesh, build_scene
    from sarmitsuba.loader.load import load_scene
    from sarmitsuba.loader.plugins import register_plugins
    from sarmitsuba.registry import load_extension
    from sarmitsuba.scene.geometry import PointTarget
    from sarmitsuba.scene.scene import Scene
    from sarmitsuba.scene.settings import TraceSettings
    from sarmitsuba.simulation.prediction.explanation import explain
    from sarmitsuba.simulation.raw import simulate
    from sarmitsuba.simulation.rcs import monostatic_rcs
    from sarmitsuba.simulation.render import render

_HOME = {
    "PointTarget": "sarmitsuba.scene.geometry",
    "RawData": "sarmitsuba.echo.raw",
    "SarImage": "sarmitsuba.image.sar_image",
    "Scene": "sarmitsuba.scene.scene",
    "SceneMesh": "sarmitsuba.loader.build",
    "TraceSettings": "sarmitsuba.scene.settings",
    "build_scene": "sarmitsuba.loader.build",
    "explain": "sarmitsuba.simulation.prediction.explanation",
    "focus": "sarmitsuba.focusing",
    "load_extension": "sarmitsuba.registry",
    "load_scene": "sarmitsuba.loader.load",
    "monostatic_rcs": "sarmitsuba.simulation.rcs",
    "register_plugins": "sarmitsuba.loader.plugins",
    "render": "sarmitsuba.simulation.render",
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


__all__ = [
    "PointTarget",
    "RawData",
    "SarImage",
    "Scene",
    "SceneMesh",
    "TraceSettings",
    "__version__",
    "build_scene",
    "explain",
    "focus",
    "load_extension",
    "load_scene",
    "monostatic_rcs",
    "register_plugins",
    "render",
    "simulate",
]
