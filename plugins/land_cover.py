"""BSDF ``land_cover``: many materials on one mesh, by a bitmap of classes."""

from sarmitsuba.loading.plugins import register
from sarmitsuba.loading.tables import LAND_COVER

from .surface import RadarSurface


@register(LAND_COVER)
class LandCover(RadarSurface):
    """Materials by class."""
