"""Focusing of raw data into calibrated complex images."""

from sarmitsuba.signal.focusing.autofocus import (
    AUTOFOCUSERS,
    Autofocuser,
    AutofocusTask,
    apply_autofocus_records,
)
from sarmitsuba.signal.focusing.focus import focus
from sarmitsuba.signal.focusing.focuser import FOCUSERS, Focused, Focuser, FocusTask
from sarmitsuba.signal.focusing.grid import default_grid, image_request
from sarmitsuba.signal.focusing.range_compression import range_compress
from sarmitsuba.signal.focusing.windows import WINDOWS, WindowFamily, WindowParameter

__all__ = [
    "AUTOFOCUSERS",
    "FOCUSERS",
    "WINDOWS",
    "AutofocusTask",
    "Autofocuser",
    "FocusTask",
    "Focused",
    "Focuser",
    "WindowFamily",
    "WindowParameter",
    "apply_autofocus_records",
    "default_grid",
    "focus",
    "image_request",
    "range_compress",
]
