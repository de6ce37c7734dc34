"""BSDF ``radar_volume``: makes a closed shape a volume that waves go through, such as the crown of a tree."""

from sarmitsuba.loading.plugins import register
from sarmitsuba.loading.tables import RADAR_VOLUME

from .surface import RadarSurface


@register(RADAR_VOLUME)
class RadarVolume(RadarSurface):
    """Vegetation by name, or a cloud of scatterers."""
