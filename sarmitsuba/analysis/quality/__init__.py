"""Image quality: points, areas and looks, measured and predicted."""

from sarmitsuba.analysis.quality.areas import Area, AreaQuality
from sarmitsuba.analysis.quality.budget import ErrorPart, error_budget
from sarmitsuba.analysis.quality.looks import Looks, spectral_looks
from sarmitsuba.analysis.quality.points import KnownPoint, PointQuality
from sarmitsuba.analysis.quality.report import QualityReport, image_quality

__all__ = [
    "Area",
    "AreaQuality",
    "ErrorPart",
    "KnownPoint",
    "Looks",
    "PointQuality",
    "QualityReport",
    "error_budget",
    "image_quality",
    "spectral_looks",
]
