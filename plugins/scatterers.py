"""BSDFs of the built-in kinds of scatterers: ``radar_wire``, ``radar_volume``."""

from sarmitsuba.loading.plugins import register
from sarmitsuba.scene.scatterers import SCATTERERS

from .surface import RadarSurface

BSDFS = [register(SCATTERERS[name].table)(type(name, (RadarSurface,), {})) for name in SCATTERERS.own_names]
