"""Sensor ``sar_antenna``: track, beam, waveform, polarisation and power of a monostatic radar."""

from sarmitsuba.core.errors import RadarError
from sarmitsuba.loading.plugins import describe, given_values, register
from sarmitsuba.loading.tables import SENSOR
from sarmitsuba.machine.backend import mi


@register(SENSOR)
class SarAntenna(mi.Sensor):
    """Holds the parameters; rays are launched by `sarmitsuba.simulate`."""

    def __init__(self, props: mi.Properties) -> None:
        self.given = given_values(props, SENSOR)
        for film in (props[key] for key in props.keys() if isinstance(props[key], mi.Film)):
            if not hasattr(film, "given"):
                raise RadarError(
                    f'sensor "{props.id()}": {film.class_name()} cannot record echoes; use range_film'
                )
        super().__init__(props)

    def to_string(self) -> str:
        """Return the parameters as text."""
        return describe(SENSOR, self.given)
