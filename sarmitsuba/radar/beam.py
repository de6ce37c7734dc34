"""Antenna from a description: a pattern with its beamwidths, or a measured one."""

from pathlib import Path

import numpy as np

from sarmitsuba.core.errors import RadarError
from sarmitsuba.core.units import power_from_db
from sarmitsuba.radar.antenna import Antenna
from sarmitsuba.radar.description import RadarInput
from sarmitsuba.radar.pattern import PATTERNS
from sarmitsuba.radar.pattern_table import PatternTable


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
    widths = [_width_of(given, *axis, wavelength) for axis in (azimuth, elevation)]
    return Antenna(s.pattern, gain, widths[0], widths[1])


def _width_of(
    given: RadarInput, width: tuple[str, float], size: tuple[str, float], wavelength: float
) -> float:
    """Half-power width along an axis, rad, as given or of the pattern's aperture of the given size."""
    pattern = PATTERNS[given.sensor.pattern]
    if (width[1] > 0.0) == (size[1] > 0.0):
        raise RadarError(
            f"{given.where}: pattern = {pattern.name} needs one of {width[0]} = {width[1]:g} deg and "
            f"{size[0]} = {size[1]:g} m above 0; give exactly one"
        )
    if width[1] > 0.0:
        return float(np.radians(width[1]))
    half = pattern.half_power_sine
    if half is None:
        raise RadarError(
            f"{given.where}: {size[0]} = {size[1]:g} m: pattern {pattern.name} belongs to no aperture; give "
            f"{width[0]}, or half_power_sine to the pattern"
        )
    sine = half * wavelength / size[1]
    if sine >= 1.0:
        raise RadarError(
            f"{given.where}: {size[0]} = {size[1]:g} m is below {half:.3f} wavelengths ({half * wavelength:g} m); "
            f"enlarge it or give {width[0]}"
        )
    return 2.0 * float(np.arcsin(sine))
