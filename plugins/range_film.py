"""Film ``range_film``: receive window and sampling of the echoes, and the image to focus."""

from sarmitsuba.loading.plugins import describe, given_values, register
from sarmitsuba.loading.tables import FILM
from sarmitsuba.machine.backend import mi


@register(FILM)
class RangeFilm(mi.Film):
    """Holds the parameters; echoes are stored by `sarmitsuba.simulate`."""

    def __init__(self, props: mi.Properties) -> None:
        self.given = given_values(props, FILM)
        super().__init__(props)

    def to_string(self) -> str:
        """Return the parameters as text."""
        return describe(FILM, self.given)
