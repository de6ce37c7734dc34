"""Findings about impossible or unfavourable combinations of radar parameters, one line each."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sarmitsuba.analysis.link.place import PlaceBudget
from sarmitsuba.analysis.link.prf_bounds import PulseTiming
from sarmitsuba.core.constants import SPEED_OF_LIGHT
from sarmitsuba.core.units import db_from_power
from sarmitsuba.radar.description import RadarInput
from sarmitsuba.radar.pattern import PATTERNS, SINC_HALF_POWER
from sarmitsuba.radar.radar import Radar
from sarmitsuba.signal.focusing.aperture_weights import flight

# least two-way power gain at the ends of an aperture relative to its middle: -20 dB
_HELD = 0.01
# tolerance of the gain over that of the beam's solid angle: rounding, and the half-power widths of a real antenna
_GAIN_SLACK = 1.26
# tolerated share of the swath's echoes overlapped by a pulse or the nadir echo: rounding
_SHARE = 1e-6
# fraction of the beam's half width within which an aperture counts as limited by the null
_CUT = 1e-6


@dataclass(frozen=True)
class Finding:
    """One remark about a radar.

    Parameters
    ----------
    name : one word
    text : place, problem, value with unit, bound, remedy
    impossible : whether the radar cannot work; else the finding is a disadvantage
    """

    name: str
    text: str
    impossible: bool


def findings(
    radar: Radar, timing: PulseTiming, places: Sequence[PlaceBudget], given: RadarInput | None
) -> tuple[Finding, ...]:
    """All remarks about a radar, the impossible first.

    Parameters
    ----------
    radar, timing : complete
    places : near, middle, far
    given : the user's radar parameters; None: the radar was built from its parts
    """
    where = given.where if given is not None else "radar"
    found = [
        *_of_the_pulses(where, timing, _remedy(timing)),
        *_of_the_antenna(where, radar, places[len(places) // 2]),
        *_of_the_aperture(where, radar, places[len(places) // 2], given),
    ]
    if radar.noise_temperature <= 0.0:
        found.append(
            Finding(
                "noise_temperature",
                f"{where}: noise_temperature = 0 K adds no noise, so that SNR and NESZ are undefined; give 290 K "
                "times the receiver's noise factor",
                False,
            )
        )
    return tuple(sorted(found, key=lambda finding: not finding.impossible))


def _remedy(timing: PulseTiming) -> str:
    free = timing.nearest_free_prf
    return f"take prf = {free:.5g} Hz" if free is not None else "shorten the swath or pulse_width"


def _of_the_pulses(where: str, t: PulseTiming, remedy: str) -> list[Finding]:
    found = []
    if t.prf < t.processed_bandwidth * (1.0 - 1e-9):
        found.append(
            Finding(
                "doppler",
                f"{where}: prf = {t.prf:.6g} Hz is below the Doppler bandwidth {t.processed_bandwidth:.6g} Hz; raise "
                "prf, coarsen azimuth_resolution or narrow the beam",
                True,
            )
        )
    elif t.prf < t.lowest_prf * (1.0 - 1e-9):
        found.append(
            Finding(
                "azimuth_ghosts",
                f"{where}: prf = {t.prf:.6g} Hz samples the Doppler bandwidth of the image, "
                f"{t.processed_bandwidth:.6g} Hz, but not that of the beam, {t.lowest_prf:.6g} Hz: echoes from outside "
                f"the image within the beam are aliased into it; with ground there, raise prf to {t.lowest_prf:.6g} Hz",
                False,
            )
        )
    if t.duty_cycle >= 1.0:
        found.append(
            Finding(
                "duty_cycle",
                f"{where}: pulse_width = {t.pulse_width:.6g} s at prf = {t.prf:.6g} Hz is a duty cycle of "
                f"{t.duty_cycle:.4g}, which must be below 1; shorten pulse_width or lower prf",
                True,
            )
        )
    elif t.prf > t.highest_prf * (1.0 + 1e-9):
        found.append(
            Finding(
                "swath",
                f"{where}: the echoes of one pulse last {1e6 * (t.echo_ends - t.echo_begins):.6g} us, and with the "
                f"next pulse of {1e6 * t.pulse_width:.6g} us do not fit into the interval of {1e6 / t.prf:.6g} us at "
                f"prf = {t.prf:.6g} Hz; lower prf to {t.highest_prf:.6g} Hz, or shorten the swath or pulse_width",
                True,
            )
        )
    elif t.blind_share > _SHARE:
        found.append(
            Finding(
                "blind_range",
                f"{where}: at prf = {t.prf:.6g} Hz a pulse is sent while {100.0 * t.blind_share:.3g} % of the swath's "
                f"echoes arrive ({1e6 * t.echo_begins:.6g} to {1e6 * t.echo_ends:.6g} us after their pulse); {remedy}",
                True,
            )
        )
    if t.nadir_share > _SHARE:
        found.append(
            Finding(
                "nadir",
                f"{where}: at prf = {t.prf:.6g} Hz the nadir echo ({1e6 * t.nadir_begins:.6g} us) overlaps "
                f"{100.0 * t.nadir_share:.3g} % of the swath's echoes; {remedy}",
                False,
            )
        )
    return found


def antenna_area(radar: Radar) -> float:
    """Area of the aperture with the antenna's half-power widths, m^2; a uniform one where the pattern names none."""
    antenna, wavelength = radar.antenna, radar.waveform.wavelength
    half = PATTERNS[antenna.pattern].half_power_sine or SINC_HALF_POWER
    length, height = (
        half * wavelength / float(np.sin(0.5 * width))
        for width in (antenna.azimuth_beamwidth, antenna.elevation_beamwidth)
    )
    return length * height


def _of_the_antenna(where: str, radar: Radar, place: PlaceBudget) -> list[Finding]:
    if not radar.antenna.directive:
        return []
    found = []
    area, wavelength = antenna_area(radar), radar.waveform.wavelength
    most = 4.0 * np.pi * area / wavelength**2
    if radar.antenna.gain > _GAIN_SLACK * most:
        found.append(
            Finding(
                "gain",
                f"{where}: gain_db = {db_from_power(radar.antenna.gain):.4g} dB is above {db_from_power(most):.4g} dB, "
                f"that of an aperture of {area:.4g} m^2 with this beam; lower it or narrow the beam",
                True,
            )
        )
    speed = float(np.linalg.norm(radar.track.velocity[radar.track.center_index]))
    tan = float(np.tan(place.incidence_angle))
    least = 4.0 * speed * wavelength * place.slant_range * tan / SPEED_OF_LIGHT
    if area < least:
        found.append(
            Finding(
                "antenna_area",
                f"{where}: an antenna of {area:.4g} m^2 is below {least:.4g} m^2 (4 v lambda R tan(theta) / c): its "
                "whole beam cannot be free of both azimuth and range ambiguities; enlarge it, or keep swath and "
                "Doppler bandwidth below the beam's",
                False,
            )
        )
    return found


def _of_the_aperture(where: str, radar: Radar, place: PlaceBudget, given: RadarInput | None) -> list[Finding]:
    asked = given.sensor.azimuth_resolution if given is not None and given.track is None else 0.0
    own = np.isfinite(radar.half_aperture)
    squint = float(flight(radar)[1][radar.track.center_index])
    null = radar.antenna.nulls[0] * float(np.sqrt(max(1.0 - squint**2, 0.0)))
    if own and asked > 0.0 and radar.half_aperture >= null * (1.0 - _CUT):
        return [
            Finding(
                "aperture",
                f"{where}: azimuth_resolution = {asked:g} m asks for a longer aperture than the beam holds between its "
                f"nulls, {place.aperture_length:.4g} m, which gives an azimuth cell of {place.azimuth_cell:.4g} m with "
                "the window; shorten antenna_length or coarsen azimuth_resolution",
                True,
            )
        ]
    if not own and place.held < _HELD:
        return [
            Finding(
                "aperture",
                f"{where}: the beam leaves the image centre within the aperture of {place.aperture_length:.4g} m: its "
                f"two-way gain at the ends is {db_from_power(max(place.held, 1e-12)):.3g} dB; use fewer pulses, a "
                "steered mode, or a wider beam",
                True,
            )
        ]
    return []
