"""BSDF ``absorber-radio-material``: Sionna RT's perfect absorber."""

import mitsuba as mi
from sarmitsuba_plugins.surface import RadarSurface

from sarmitsuba.loader.tables import ABSORBER

SIONNA = True  # left to Sionna RT where it is imported


class AbsorberRadioMaterial(RadarSurface):
    """Blocks and returns nothing."""

    table = ABSORBER


def register() -> str:
    """Make it known to Mitsuba and return its name."""
    mi.register_bsdf(ABSORBER.plugin, lambda props: AbsorberRadioMaterial(props))
    return ABSORBER.plugin
