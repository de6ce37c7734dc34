"""Sensor ``sar_antenna``: track, beam, waveform, polarisation and power of a monostatic radar."""

import mitsuba as mi

from sarmitsuba.loader.plugins import describe, given_values
from sarmitsuba.loader.tables import SENSOR


class SarAntenna(mi.Sensor):
    """Holds the parameters; rays are launched by `sarmitsuba.simulate`."""

    def __init__(self, props: mi.Properties) -> None:
        self.given = given_values(props, SENSOR)
        super().__init__(props)

    def to_string(self) -> str:
        """Return the parameters as text."""
        return describe(SENSOR, self.given)


def register() -> str:
    """Make it known to Mitsuba and return its name."""
    mi.register_sensor(SENSOR.plugin, lambda props: SarAntenna(props))
    return SENSOR.plugin
