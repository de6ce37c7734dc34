"""BSDF ``point_scatterer``: turns a sphere into an ideal scatterer at its centre."""

from sarmitsuba.loading.plugins import register
from sarmitsuba.loading.tables import POINT_SCATTERER

from .surface import RadarSurface


@register(POINT_SCATTERER)
class PointScatterer(RadarSurface):
    """Radar cross section and phase of a point."""
