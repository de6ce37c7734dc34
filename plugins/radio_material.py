"""BSDF ``radio-material``: Sionna RT's general material."""

from sarmitsuba.loading.plugins import register
from sarmitsuba.loading.tables import RADIO_MATERIAL

from .surface import RadarSurface


@register(RADIO_MATERIAL, sionna=True)
class RadioMaterial(RadarSurface):
    """Permittivity and conductivity of a surface."""
