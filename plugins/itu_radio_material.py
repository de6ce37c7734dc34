"""BSDF ``itu-radio-material``: Sionna RT's ITU material."""

import mitsuba as mi
from sarmitsuba_plugins.surface import RadarSurface

from sarmitsuba.loader.tables import ITU_RADIO_MATERIAL

SIONNA = True  # left to Sionna RT where it is imported


class ItuRadioMaterial(RadarSurface):
    """ITU-R P.2040 material by name."""

    table = ITU_RADIO_MATERIAL


def register() -> str:
    """Make it known to Mitsuba and return its name."""
    mi.register_bsdf(ITU_RADIO_MATERIAL.plugin, lambda props: ItuRadioMaterial(props))
    return ITU_RADIO_MATERIAL.plugin
