"""BSDF ``radar_wire``: turns a cylinder or a line into wires that scatter by a closed form."""

from sarmitsuba.loading.plugins import register
from sarmitsuba.loading.tables import RADAR_WIRE

from .surface import RadarSurface


@register(RADAR_WIRE)
class RadarWire(RadarSurface):
    """What wires are made of."""
