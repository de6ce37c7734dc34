"""BSDF ``radar_material``: smooth or rough half space, conductor or dielectric."""

import mitsuba as mi
from sarmitsuba_plugins.surface import RadarSurface

from sarmitsuba.loader.tables import RADAR_MATERIAL


class RadarMaterial(RadarSurface):
    """Permittivity, roughness and diffuse law of a surface."""

    table = RADAR_MATERIAL


def register() -> str:
    """Make it known to Mitsuba and return its name."""
    mi.register_bsdf(RADAR_MATERIAL.plugin, lambda props: RadarMaterial(props))
    return RADAR_MATERIAL.plugin
