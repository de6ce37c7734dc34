"""BSDF ``absorber-radio-material``: Sionna RT's perfect absorber."""

from sarmitsuba.loader.plugins import register
from sarmitsuba.loader.tables import ABSORBER

from .surface import RadarSurface


@register(ABSORBER, sionna=True)
class AbsorberRadioMaterial(RadarSurface):
    """Blocks and returns nothing."""
