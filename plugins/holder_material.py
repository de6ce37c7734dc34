"""BSDF ``holder-material``: Sionna RT's wrapper around one material."""

from sarmitsuba.loading.plugins import register
from sarmitsuba.loading.tables import HOLDER

from .surface import RadarSurface


@register(HOLDER, sionna=True)
class HolderMaterial(RadarSurface):
    """Takes the meaning of the BSDF nested in it."""
