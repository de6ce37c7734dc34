"""Image quality of points and areas, multilooking, and error budget."""

from sarmitsuba.analysis.quality.areas import Area, AreaQuality
from sarmitsuba.analysis.quality.error_budget import ErrorPart, error_budget
from sarmitsuba.analysis.quality.image_report import QualityReport, image_quality
from sarmitsuba.analysis.quality.looks import Looks, spectral_looks
from sarmitsuba.analysis.quality.point_quality import KnownPoint, PointQuality

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
