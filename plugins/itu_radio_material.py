"""BSDF ``itu-radio-material``: Sionna RT's ITU material."""

from sarmitsuba.loading.plugins import register
from sarmitsuba.loading.tables import ITU_RADIO_MATERIAL

from .surface import RadarSurface


@register(ITU_RADIO_MATERIAL, sionna=True)
class ItuRadioMaterial(RadarSurface):
    """ITU-R P.2040 material by name."""
