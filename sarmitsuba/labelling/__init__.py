"""Labels of an image's pixels: geometry, and what the echoes in them come from."""

from sarmitsuba.labelling.makers import labels

__all__ = ["labels"]
