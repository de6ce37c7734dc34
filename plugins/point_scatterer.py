"""BSDF ``point_scatterer``: turns a sphere into an ideal scatterer at its centre."""

import mitsuba as mi
from sarmitsuba_plugins.surface import RadarSurface

from sarmitsuba.loader.tables import POINT_SCATTERER


class PointScatterer(RadarSurface):
    """Radar cross section and phase of a point."""

    table = POINT_SCATTERER


def register() -> str:
    """Make it known to Mitsuba and return its name."""
    mi.register_bsdf(POINT_SCATTERER.plugin, lambda props: PointScatterer(props))
    return POINT_SCATTERER.plugin
