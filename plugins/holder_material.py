"""BSDF ``holder-material``: Sionna RT's wrapper around one material."""

import mitsuba as mi
from sarmitsuba_plugins.surface import RadarSurface

from sarmitsuba.loader.tables import HOLDER

SIONNA = True  # left to Sionna RT where it is imported


class HolderMaterial(RadarSurface):
    """Takes the meaning of the BSDF nested in it."""

    table = HOLDER


def register() -> str:
    """Make it known to Mitsuba and return its name."""
    mi.register_bsdf(HOLDER.plugin, lambda props: HolderMaterial(props))
    return HOLDER.plugin
