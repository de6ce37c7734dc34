"""Labels of an image's pixels: geometry, and what the echoes in them come from."""

from sarmitsuba.analysis.labels.makers import labels

__all__ = ["labels"]
