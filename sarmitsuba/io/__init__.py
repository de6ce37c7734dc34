"""Files: one module a format, every file written whole or not at all."""

from sarmitsuba.io.formats import read_image, read_raw, write_image, write_raw

__all__ = ["read_image", "read_raw", "write_image", "write_raw"]
