"""Focusing of raw data into calibrated complex images."""

from sarmitsuba.focusing.autofocus import AUTOFOCUSERS, Autofocuser, AutofocusTask, apply_autofocus_records
from sarmitsuba.focusing.focus import focus
from sarmitsuba.focusing.focuser import FOCUSERS, Focused, Focuser, FocusTask
from sarmitsuba.focusing.grid import default_grid, image_request
from sarmitsuba.focusing.range_compression import range_compress
from sarmitsuba.focusing.windows import WINDOWS, WindowFamily, WindowParameter

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
