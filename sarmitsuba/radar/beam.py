"""Antenna from a description: a pattern with its beamwidths, or a measured one."""

from pathlib import Path

import numpy as np

from sarmitsuba.errors import RadarError
from sarmitsuba.radar.antenna import Antenna
from sarmitsuba.radar.description import RadarInput
from sarmitsuba.radar.pattern import PATTERNS, SINC_HALF_POWER
from sarmitsuba.radar.pattern_table import PatternTable
from sarmitsuba.units import power_from_db


def antenna_of(given: RadarInput, wavelength: float) -> Antenna:
    """The antenna of a description.

    Parameters
    ----------
    given : parameters
    wavelength : at the centre frequency, m; converts aperture sizes to beamwidths

    Raises
    ------
    RadarError
        Parameters are missing or contradict each other, or the file of a measured pattern is invalid.
    """
    s = given.sensor
    gain = float(power_from_db(s.gain_db))
    azimuth = (("azimuth_beamwidth_deg", s.azimuth_beamwidth_deg), ("antenna_length", s.antenna_length))
    elevation = (("elevation_beamwidth_deg", s.elevation_beamwidth_deg), ("antenna_height", s.antenna_height))
    measured = PATTERNS[s.pattern].measured
    if s.pattern == "isotropic" or measured:
        for name, value in (*azimuth, *elevation):
            if value > 0.0:
                raise RadarError(
                    f"{given.where}: {name} = {value:g} has no effect with pattern = {s.pattern}; "
                    f"{'the table has its own widths' if measured else 'set pattern to gaussian or rectangular'}"
                )
    if s.pattern_file and not measured:
        raise RadarError(
            f"{given.where}: pattern_file has no effect with pattern = {s.pattern}; set pattern to table or leave "
            "it out"
        )
    if measured:
        if not s.pattern_file:
            raise RadarError(f"{given.where}: pattern = {s.pattern} needs a pattern_file; give its path")
        path = Path(s.pattern_file)
        table = PatternTable.from_csv(path if path.is_absolute() else given.folder / path)
        widths = [cut.beamwidth for cut in table.cuts]
        return Antenna(s.pattern, gain, widths[0], widths[1], table)
    if s.pattern == "isotropic":
        return Antenna("isotropic", gain)
    widths = []
    for (width_name, width), (size_name, size) in (azimuth, elevation):
        if (width > 0.0) == (size > 0.0):
            raise RadarError(
                f"{given.where}: pattern = {s.pattern} needs one of {width_name} = {width:g} deg and "
                f"{size_name} = {size:g} m above 0; give exactly one"
            )
        if size > 0.0:
            sine = SINC_HALF_POWER * wavelength / size
            if sine >= 1.0:
                raise RadarError(
                    f"{given.where}: {size_name} = {size:g} m is below {SINC_HALF_POWER:.3f} wavelengths "
                    f"({SINC_HALF_POWER * wavelength:g} m); enlarge it or give {width_name}"
                )
            widths.append(2.0 * float(np.arcsin(sine)))
        else:
            widths.append(float(np.radians(width)))
    return Antenna(s.pattern, gain, widths[0], widths[1])
