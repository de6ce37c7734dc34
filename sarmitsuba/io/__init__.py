"""Files: one module per format, every file written whole or not at all."""

from sarmitsuba.io.formats import FORMATS, FileFormat, read_image, read_raw, write_image, write_raw

__all__ = ["FORMATS", "FileFormat", "read_image", "read_raw", "write_image", "write_raw"]
