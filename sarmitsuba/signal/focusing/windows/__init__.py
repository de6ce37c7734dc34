"""Weighting functions over a band or an aperture: one file per family, chosen by name and parameters."""

from sarmitsuba.signal.focusing.windows.window import (
    WINDOWS,
    Window,
    WindowFamily,
    WindowParameter,
    parse_window,
)

__all__ = ["WINDOWS", "Window", "WindowFamily", "WindowParameter", "parse_window"]
