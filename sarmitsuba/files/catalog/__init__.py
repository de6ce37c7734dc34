"""File formats, one per file; see :mod:`sarmitsuba.files.formats`."""
