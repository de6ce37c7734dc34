"""Radiometric quantities of a calibrated image, and calibration against a target of known RCS."""

from dataclasses import replace
from typing import Literal

import numpy as np

from sarmitsuba.core.arrays import F64
from sarmitsuba.core.errors import DataError
from sarmitsuba.signal.image.sar_image import SarImage

Quantity = Literal["rcs", "sigma0", "beta0", "gamma0"]
QUANTITIES: tuple[str, ...] = ("rcs", "sigma0", "beta0", "gamma0")


def backscatter(image: SarImage, quantity: Quantity = "sigma0", channel: str | None = None) -> F64:
    r"""Intensity of an image as a radiometric quantity, linear, (n_azimuth, n_range) float64.

    ``rcs``: of a point at its peak, m^2; ``sigma0``: per ground area, :math:`\sigma^0 = |I|^2 / A`;
    ``beta0``: per slant-plane area, :math:`\beta^0 = \sigma^0 / \sin\theta_i`; ``gamma0``: per area across the line of
    sight, :math:`\gamma^0 = \sigma^0 / \cos\theta_i`.

    Notes
    -----
    Ignores terrain: incidence is that of the image's horizontal plane.

    References
    ----------
    Raney et al., A plea for radar brightness, IGARSS 1994.
    """
    if quantity not in QUANTITIES:
        raise DataError(f"backscatter {quantity!r}: unknown; choose one of {', '.join(QUANTITIES)}")
    if quantity == "rcs":
        return image.rcs(channel)
    sigma0 = image.sigma0(channel)
    if quantity == "beta0":
        return np.asarray(sigma0 / np.sin(image.incidence_angle))
    if quantity == "gamma0":
        return np.asarray(sigma0 / np.cos(image.incidence_angle))
    return sigma0


def calibrate(image: SarImage, measured_rcs: float, known_rcs: float) -> SarImage:
    """Scale an image so that a reference target's measured peak becomes its known RCS (both m^2).

    Needed only for images from external raw data of unknown gain.
    """
    if not (measured_rcs > 0.0 and known_rcs > 0.0):
        raise DataError(
            f"calibration: measured_rcs = {measured_rcs:g} and known_rcs = {known_rcs:g} m^2 must be above 0"
        )
    factor = np.sqrt(known_rcs / measured_rcs)
    total = float(factor) * float(image.metadata.get("calibration_factor", 1.0))
    facts = {**image.metadata, "calibration_factor": total, "calibrated": True}
    return replace(image, data=(image.data * np.float32(factor)).astype(np.complex64), metadata=facts)
