"""File formats, one per file; see :mod:`sarmitsuba.io.formats`."""
