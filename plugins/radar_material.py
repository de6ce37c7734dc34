"""BSDF ``radar_material``: smooth or rough half space, conductor or dielectric."""

from sarmitsuba.loading.plugins import register
from sarmitsuba.loading.tables import RADAR_MATERIAL

from .surface import RadarSurface


@register(RADAR_MATERIAL)
class RadarMaterial(RadarSurface):
    """Permittivity, roughness and diffuse law of a surface."""
