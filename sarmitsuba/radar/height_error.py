"""Radiometric error of scatterers off the image plane: the beam is corrected at the pixel's elevation, not theirs."""

from dataclasses import dataclass

import numpy as np

from sarmitsuba.core.arrays import F64
from sarmitsuba.core.units import db_from_amplitude
from sarmitsuba.radar.image_request import ImageRequest
from sarmitsuba.radar.radar import Radar

# dB: above the first a note, above the second a warning
NOTED_DB, WARNED_DB = 0.1, 1.0
# two-way amplitude over the beam's peak below which a place counts as not illuminated: -20 dB
_DARK = 0.1
# smallest amplitude evaluated: -80 dB
_LEAST = 1e-4


@dataclass(frozen=True)
class HeightError:
    """Largest radiometric error of the beam correction because of height.

    Parameters
    ----------
    error_db : of a place's radar cross section; positive: too bright
    height : m, of that place over the image plane
    lowest, highest : m, of all places in the image, over the image plane
    """

    error_db: float
    height: float
    lowest: float
    highest: float

    def text(self) -> str:
        """Message with the error, the heights and the remedy."""
        return (
            f"places {self.lowest:.3g} to {self.highest:.3g} m over the image plane are corrected for the beam at the "
            f"elevation of their pixel, not at their own: levels are off by up to {self.error_db:+.2g} dB, at "
            f"{self.height:.3g} m; widen the beam in elevation, aim nearer to its middle, or set image_height"
        )


def height_error(radar: Radar, request: ImageRequest, places: F64) -> HeightError | None:
    r"""Radiometric error of focusing on a plane, because heights are unknown, dB.

    A point q of height h appears in the pixel p of the same range and closest approach, and is corrected for the gain
    towards p: :math:`20 \log_{10} g(q) / g(p)`, g the two-way amplitude in elevation.

    Parameters
    ----------
    radar : its beam, at mid-aperture
    request : the image, with the height of its plane
    places : (n, 3) m, scene frame; scatterers

    Returns
    -------
    None where the antenna is isotropic, or no illuminated place is in the image

    Notes
    -----
    Assumes a level and straight track. Ignores shadows, and places between the given ones.
    """
    if not radar.antenna.directive or not len(places):
        return None
    middle, along, across = radar.track.center_index, radar.track.along, radar.across
    antenna = radar.track.position[middle]
    center = np.array([request.center_x, request.center_y, request.height])
    leg = places - antenna
    drop = antenna[2] - request.height
    closest = np.hypot(leg @ across, leg[:, 2])
    ground = np.sqrt(np.maximum(closest**2 - drop**2, 0.0))
    inside = (closest > drop) & (leg @ across > 0.0)
    inside &= np.abs((places - center) @ along) <= 0.5 * request.extent_azimuth
    inside &= np.abs(ground - (center - antenna) @ across) <= 0.5 * request.extent_range
    if not inside.any():
        return None
    leg, closest, ground = leg[inside], closest[inside], ground[inside]

    pointing = radar.pointing
    ahead = float(pointing.boresight[middle] @ along)
    aside = np.sqrt(1.0 - ahead**2)

    def gain(across_: F64, up: F64) -> F64:
        """Two-way amplitude when the beam centre passes a place."""
        look = ahead * along + aside * (across_[:, None] * across + up[:, None] * [0.0, 0.0, 1.0])
        return np.asarray(
            radar.antenna.two_way_amplitude(
                look @ pointing.azimuth_axis[middle], look @ pointing.elevation_axis[middle]
            )
        )

    own = gain(leg @ across / closest, leg[:, 2] / closest)
    pixel = gain(ground / closest, np.full(len(closest), -drop) / closest)
    lit = np.maximum(own, pixel) >= _DARK
    if not lit.any():
        return None
    height = places[inside][:, 2] - request.height
    error = db_from_amplitude(np.maximum(own, _LEAST) / np.maximum(pixel, _LEAST)) * lit
    worst = int(np.argmax(np.abs(error)))
    return HeightError(float(error[worst]), float(height[worst]), float(height.min()), float(height.max()))
