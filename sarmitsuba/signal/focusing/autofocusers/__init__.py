"""The autofocusers that come with the package, one file each; see :mod:`sarmitsuba.signal.focusing.autofocus`."""
