"""Polarisation channels: linear ones, and compact ones (circular or slanted transmit, linear receive).

A channel has two letters, that of the transmitted wave first. Horizontal and vertical are ``h = u x up / |u x up|``
and ``v = h x u`` for the look direction u (antenna to scene), the same on transmit and receive (backscatter alignment).
"""

from collections.abc import Sequence

from sarmitsuba.core.errors import RadarError
from sarmitsuba.core.parameters import one_line

_ROOT_HALF = 0.5**0.5
# (h, v) parts of a transmitted wave of unit power. Time convention exp(+j w t): along u, v turns into h clockwise for
# who looks along u, so the field v - j h = -j (h + j v) turns clockwise: right-handed in the sense of the IEEE
TRANSMITTED: dict[str, tuple[complex, complex]] = {
    "H": (1.0, 0.0),
    "V": (0.0, 1.0),
    "R": (_ROOT_HALF, 1j * _ROOT_HALF),
    "L": (_ROOT_HALF, -1j * _ROOT_HALF),
    "D": (_ROOT_HALF, _ROOT_HALF),
}
RECEIVED = ("H", "V")
LINEAR = ("HH", "HV", "VH", "VV")
COMPACT = tuple(sent + received for sent in ("R", "L", "D") for received in RECEIVED)
CHANNELS = (*LINEAR, *COMPACT)


def read_channels(text: str, where: str) -> tuple[str, ...]:
    """Channels of a list such as ``HH,HV``.

    Raises
    ------
    RadarError
        A name is unknown or occurs twice, or there is none.
    """
    names = tuple(text.replace(",", " ").upper().split())
    bad = [name for name in names if name not in CHANNELS]
    if bad or not names or len(set(names)) < len(names):
        raise RadarError(
            f'{where}: polarisation = "{one_line(text)}" is not a list of channels from {", ".join(CHANNELS)}; '
            'give for example "HH,HV" or "RH,RV"'
        )
    return names


def linear_parts(channel: str) -> tuple[tuple[complex, str], ...]:
    r"""A channel as a sum of linear ones, with their factors.

    .. math:: RH = (HH + j\,VH) / \sqrt 2, \quad RV = (HV + j\,VV) / \sqrt 2

    (transmit letter first; ``L`` has ``-j``, ``D``, slanted by 45 degrees, has ``+1``). A linear channel is itself.
    """
    factors = zip(TRANSMITTED[channel[0]], RECEIVED, strict=True)
    return tuple((factor, sent + channel[1]) for factor, sent in factors if factor)


def isotropic_response(channel: str) -> complex:
    """Response in a channel of a scatterer of unit RCS that does not depolarise (HH = VV = 1)."""
    return sum((factor for factor, part in linear_parts(channel) if part[0] == part[1]), 0.0j)


def linear_letters(channels: Sequence[str]) -> set[str]:
    """Linear polarisations, H and V, that channels send or receive."""
    return {letter for channel in channels for _, part in linear_parts(channel) for letter in part}
