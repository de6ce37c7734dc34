"""ScanSAR: bursts of one sub-swath after the other, the beam stepped in elevation and at rest in azimuth."""

from sarmitsuba.radar.bursts import PARAMETERS, BurstMode
from sarmitsuba.radar.mode import MODES


class ScanSar(BurstMode):
    r"""Beam fixed to the antenna during a burst, at the elevation of its sub-swath.

    All pulses of a burst of the length :math:`T_B` serve every pixel: the azimuth cell is that of their track,
    :math:`\lambda R / (2 v T_B)`. Places are seen in different parts of the beam (scalloping); the focusers divide by
    the gain that they were seen with, which leaves a noise level that changes over the burst.

    References
    ----------
    R. Bamler, "Optimum look weighting for burst-mode and ScanSAR processing", IEEE Trans. Geosci. Remote Sens. 33 (3),
    1995.
    """

    name = "scansar"
    doc = "bursts of each sub-swath in turn, beam stepped in elevation"
    parameters = PARAMETERS


MODES.register(ScanSar())
