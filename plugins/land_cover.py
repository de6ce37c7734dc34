"""BSDF ``land_cover``: many materials on one mesh, by a bitmap of classes."""

from sarmitsuba.loader.plugins import register
from sarmitsuba.loader.tables import LAND_COVER

from .surface import RadarSurface


@register(LAND_COVER)
class LandCover(RadarSurface):
    """Materials by class."""
