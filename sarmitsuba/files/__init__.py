"""Input and output: one module per file format, every file written atomically."""

from sarmitsuba.files.formats import FORMATS, FileFormat, read_image, read_raw, write_image, write_raw

__all__ = ["FORMATS", "FileFormat", "read_image", "read_raw", "write_image", "write_raw"]
