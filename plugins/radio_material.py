"""BSDF ``radio-material``: Sionna RT's general material."""

import mitsuba as mi
from sarmitsuba_plugins.surface import RadarSurface

from sarmitsuba.loader.tables import RADIO_MATERIAL

SIONNA = True  # left to Sionna RT where it is imported


class RadioMaterial(RadarSurface):
    """Permittivity and conductivity of a surface."""

    table = RADIO_MATERIAL


def register() -> str:
    """Make it known to Mitsuba and return its name."""
    mi.register_bsdf(RADIO_MATERIAL.plugin, lambda props: RadioMaterial(props))
    return RADIO_MATERIAL.plugin
