"""How good an image is: points, areas, looks; measured from its pixels, beside what is predicted."""

from sarmitsuba.quality.areas import Area, AreaQuality
from sarmitsuba.quality.budget import ErrorPart, error_budget
from sarmitsuba.quality.looks import Looks, spectral_looks
from sarmitsuba.quality.points import KnownPoint, PointQuality
from sarmitsuba.quality.report import QualityReport, image_quality

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
