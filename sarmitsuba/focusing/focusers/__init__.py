"""The focusers that come with the package, one file each; see :mod:`sarmitsuba.focusing.focuser`."""
