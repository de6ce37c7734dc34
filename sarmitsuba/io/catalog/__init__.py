"""The file formats that come with the package, one file each; see :mod:`sarmitsuba.io.formats`."""
