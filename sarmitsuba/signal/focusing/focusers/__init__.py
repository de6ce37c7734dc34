"""The focusers that come with the package, one file each; see :mod:`sarmitsuba.signal.focusing.focuser`."""
