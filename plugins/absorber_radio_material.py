"""BSDF ``absorber-radio-material``: Sionna RT's perfect absorber."""

from sarmitsuba.loading.plugins import register
from sarmitsuba.loading.tables import ABSORBER

from .surface import RadarSurface


@register(ABSORBER, sionna=True)
class AbsorberRadioMaterial(RadarSurface):
    """Blocks and returns nothing."""
