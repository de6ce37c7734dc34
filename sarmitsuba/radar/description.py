"""Description of a radar: the parameters of ``sar_antenna``, typed.

The fields below are their only list: the tables for reading scene files and the documentation are made from it.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Literal

import numpy as np

from sarmitsuba.core.errors import RadarError
from sarmitsuba.core.parameters import (
    ParamTable,
    Value,
    declare_field,
    fill_description,
    knows_its_fields,
    params_of,
)
from sarmitsuba.radar.film import FILM, FilmDescription
from sarmitsuba.radar.mode import MODES, mode_parameters
from sarmitsuba.radar.pattern import PATTERNS
from sarmitsuba.radar.track import Track


@knows_its_fields
@dataclass(frozen=True, kw_only=True)
class RadarDescription:
    """Parameters of a side-looking radar; every field has its own documentation.

    Lengths in m, times in s, frequencies in Hz, angles in degrees and ratios in dB as the names say. 0 means automatic
    where the documentation of a parameter says so.
    """

    mode: str = declare_field(
        "stripmap", "how the beam is steered", choices=lambda: tuple(sorted(MODES.names))
    )
    slant_range: float = declare_field(
        10e3, "distance from the antenna at mid-aperture to the aim point", "m", 1.0, 1e9
    )
    look_angle_deg: float = declare_field(
        45.0,
        "angle between nadir and the line of sight to the aim point, at mid-aperture",
        "deg",
        0.0,
        89.999,
        positive=True,
    )
    heading_deg: float = declare_field(
        0.0, "flight direction, clockwise from north (+y)", "deg", -360.0, 360.0
    )
    look_side: Literal["left", "right"] = declare_field(
        "right", "side of the flight direction that the radar looks to", choices=("left", "right")
    )
    squint_angle_deg: float = declare_field(
        0.0,
        "angle between the line of sight and the plane across the track; positive looks forward",
        "deg",
        -80.0,
        80.0,
    )
    aim_x: float | None = declare_field(
        None, "aim point, east, in the file's frame; default: the middle of the geometry", "m", -1e9, 1e9
    )
    aim_y: float | None = declare_field(
        None, "aim point, north, in the file's frame; default: the middle of the geometry", "m", -1e9, 1e9
    )
    aim_z: float | None = declare_field(
        None, "aim point, up, in the file's frame; default: the height of the ground", "m", -1e9, 1e9
    )
    speed: float = declare_field(100.0, "speed of the antenna", "m/s", 0.001, 1e6)
    prf: float = declare_field(
        0.0,
        "pulse repetition frequency; automatic: 1.25 times the Doppler bandwidth of aperture and image, "
        "or of the beam where that is smaller",
        "Hz",
        0.0,
        1e8,
        auto=True,
    )
    prf_jitter: float = declare_field(
        0.0, "random variation of the intervals between pulses, rms over their mean 1 / prf", "", 0.0, 0.2
    )
    prf_jitter_seed: int = declare_field(0, "seed of the intervals", "", 0, 2**31 - 1)
    pri_sequence: str = declare_field(
        "",
        "staggered PRF: intervals between pulses that repeat, over their mean 1 / prf; a list such as 0.9,1,1.1 (its "
        "own mean is divided out), or ramp:N:SPAN for N intervals that fall evenly from 1 + SPAN / 2 to 1 - SPAN / 2",
    )
    n_pulses: int = declare_field(
        0,
        "pulses of the track; automatic: the aperture of azimuth_resolution, and in stripmap and sliding spotlight "
        "with a beam also the image's azimuth extent, so that every row has its whole aperture",
        "",
        0,
        10_000_000,
        auto=True,
    )
    azimuth_resolution: float = declare_field(
        0.0,
        "azimuth cell lambda R / (2 L cos(squint)) of the aperture length L; automatic: the slant-range "
        "cell, or what n_pulses gives; mode circular has arc_deg in its place",
        "m",
        0.0,
        1e6,
        auto=True,
    )
    track_file: str = declare_field(
        "",
        "CSV of time_s, x_m, y_m, z_m, one pulse per line, in the file's frame; replaces slant_range, "
        "look_angle_deg, heading_deg, squint_angle_deg, speed, prf, n_pulses and "
        "azimuth_resolution",
    )
    orbit_altitude: float = declare_field(
        0.0,
        "altitude of a circular orbit over the Earth's equatorial radius (6378137 m); "
        "replaces slant_range, look_angle_deg, heading_deg and speed; 0 = no orbit",
        "m",
        0.0,
        1e8,
    )
    orbit_inclination_deg: float = declare_field(
        97.5, "inclination of the orbit to the equator; above 90 it flies westwards", "deg", 0.0, 180.0
    )
    orbit_pass: Literal["ascending", "descending"] = declare_field(
        "ascending", "northbound or southbound over the scene", choices=("ascending", "descending")
    )
    incidence_angle_deg: float = declare_field(
        35.0,
        "angle between the vertical (z) and the line of sight at the aim point, from an orbit, at mid-aperture",
        "deg",
        0.0,
        89.0,
        positive=True,
    )
    state_vectors_file: str = declare_field(
        "",
        "CSV of time_s (or UTC as 2024-05-01T12:00:00.5), x_m, y_m, z_m, vx_m_s, vy_m_s, vz_m_s, Earth-centred "
        "Earth-fixed, or Sentinel-1's orbit file (.EOF); in place of orbit_altitude, mid-aperture is when the aim "
        "point is seen at squint_angle_deg",
    )
    latitude_deg: float = declare_field(
        0.0,
        "WGS-84 latitude of the origin of the file's frame, whose x is east, y north and z up there; the default "
        "lies in the Gulf of Guinea, which every orbit passes",
        "deg",
        -90.0,
        90.0,
    )
    longitude_deg: float = declare_field(
        0.0, "WGS-84 longitude of the origin of the file's frame", "deg", -360.0, 360.0
    )
    height: float = declare_field(
        0.0, "height of the origin of the file's frame over the WGS-84 ellipsoid", "m", -1e4, 1e6
    )
    epoch: str = declare_field(
        "",
        "UTC of the track's time zero, mid-aperture unless a file gives times, as 2024-05-01T12:00:00.5Z; files "
        "with dates have their own; automatic: 2000-01-01T00:00:00Z, or the dates of the file",
    )
    recorded_track_file: str = declare_field(
        "",
        "CSV as track_file, of the same pulses: recorded positions, which the focuser uses, where they differ from "
        "those flown; echoes are those of the track flown",
    )
    track_offset_along: float = declare_field(
        0.0,
        "constant error of the recorded positions, along the track; echoes are those of the track flown",
        "m",
        -1e4,
        1e4,
    )
    track_offset_across: float = declare_field(
        0.0,
        "constant error of the recorded positions, to the right of the track; echoes are those of the track flown",
        "m",
        -1e4,
        1e4,
    )
    track_offset_up: float = declare_field(
        0.0,
        "constant error of the recorded positions, upwards; echoes are those of the track flown",
        "m",
        -1e4,
        1e4,
    )
    track_drift_along: float = declare_field(
        0.0,
        "growth of the recorded positions' error over time, along the track; 0 at mid-aperture",
        "m/s",
        -1e3,
        1e3,
    )
    track_drift_across: float = declare_field(
        0.0,
        "growth of the recorded positions' error over time, to the right of the track; 0 at mid-aperture",
        "m/s",
        -1e3,
        1e3,
    )
    track_drift_up: float = declare_field(
        0.0, "growth of the recorded positions' error over time, upwards; 0 at mid-aperture", "m/s", -1e3, 1e3
    )
    track_jitter: float = declare_field(
        0.0, "random error of the recorded positions, rms along each axis", "m", 0.0, 1e3
    )
    track_jitter_corner: float = declare_field(
        0.1, "corner f_c of the jitter's power spectrum 1 / (1 + (f / f_c)^slope)", "Hz", 1e-6, 1e6
    )
    track_jitter_slope: float = declare_field(
        4.0, "exponent of the jitter's power spectrum; 2 is a Gauss-Markov process", "", 0.0, 100.0
    )
    track_jitter_seed: int = declare_field(0, "seed of the jitter", "", 0, 2**31 - 1)
    pass_offset_along: float = declare_field(
        0.0,
        "baseline of a parallel pass: shift of the whole track along itself",
        "m",
        -1e6,
        1e6,
    )
    pass_offset_across: float = declare_field(
        0.0,
        "baseline of a parallel pass: shift of the whole track to its right, same aim point",
        "m",
        -1e6,
        1e6,
    )
    pass_offset_up: float = declare_field(
        0.0, "baseline of a parallel pass: shift of the whole track upwards, same aim point", "m", -1e6, 1e6
    )
    receiver_offset_along: float = declare_field(
        0.0,
        "position of a separate receiver relative to the transmitter, along the track; constant over the track",
        "m",
        -1e6,
        1e6,
    )
    receiver_offset_across: float = declare_field(
        0.0,
        "position of a separate receiver relative to the transmitter, to the right of the track",
        "m",
        -1e6,
        1e6,
    )
    receiver_offset_up: float = declare_field(
        0.0, "position of a separate receiver relative to the transmitter, upwards", "m", -1e6, 1e6
    )
    receiver_track_file: str = declare_field(
        "",
        "CSV as track_file, of the same pulses: positions of a separate receiver when the echoes arrive; in place of "
        "receiver_offset_along, receiver_offset_across and receiver_offset_up",
    )
    center_frequency: float = declare_field(9.6e9, "carrier frequency", "Hz", 1e6, 1e12)
    bandwidth: float = declare_field(300e6, "bandwidth swept by the pulse", "Hz", 1000.0, 1e12)
    pulse_width: float = declare_field(2e-06, "length of the transmitted pulse", "s", 1e-10, 1.0)
    pulse_form: str = declare_field(
        "up",
        "frequency over the pulse: up or down, linear; nlfm:PEDESTAL; or a phase code barker:N, frank:N, p4:N, or "
        "file:PATH with the column phase_deg",
    )
    pulse_filter: Literal["auto", "flat", "matched", "mismatched"] = declare_field(
        "auto",
        "range compression: flat divides by the pulse's spectrum, matched is best against noise, mismatched lowers the "
        "side lobes of codes; auto: flat of linear, matched of others",
        choices=("auto", "flat", "matched", "mismatched"),
    )
    polarisation: str = declare_field(
        "VV",
        "channels, transmit letter first, separated by commas: HH, HV, VH, VV; compact ones: RH, RV (right-circular "
        "transmit), LH, LV (left-circular), DH, DV (slanted by 45 deg)",
    )
    pattern: str = declare_field(
        "isotropic", "antenna pattern", choices=lambda: tuple(sorted(PATTERNS.names))
    )
    pattern_file: str = declare_field(
        "",
        "CSV of cut, angle_deg, gain_db, the cut azimuth or elevation, for pattern = table: one-way power gain over "
        "the angle off boresight",
    )
    pointing_error_azimuth_deg: float = declare_field(
        0.0,
        "true minus nominal direction of the beam in azimuth, positive forward; the focuser uses the nominal one",
        "deg",
        -90.0,
        90.0,
    )
    pointing_error_elevation_deg: float = declare_field(
        0.0,
        "true minus nominal direction of the beam in elevation, positive upward; the focuser uses the nominal one",
        "deg",
        -90.0,
        90.0,
    )
    pointing_drift_azimuth_deg: float = declare_field(
        0.0,
        "growth of the beam's error in azimuth over time; 0 at mid-aperture",
        "deg/s",
        -1e3,
        1e3,
    )
    pointing_drift_elevation_deg: float = declare_field(
        0.0,
        "growth of the beam's error in elevation over time; 0 at mid-aperture",
        "deg/s",
        -1e3,
        1e3,
    )
    pointing_jitter_deg: float = declare_field(
        0.0, "random error of the beam's direction, rms in azimuth and in elevation", "deg", 0.0, 90.0
    )
    pointing_jitter_corner: float = declare_field(
        0.1, "corner f_c of the pointing jitter's power spectrum 1 / (1 + (f / f_c)^slope)", "Hz", 1e-6, 1e6
    )
    pointing_jitter_slope: float = declare_field(
        4.0, "exponent of the pointing jitter's power spectrum; 2 is a Gauss-Markov process", "", 0.0, 100.0
    )
    pointing_jitter_seed: int = declare_field(0, "seed of the pointing jitter", "", 0, 2**31 - 1)
    azimuth_beamwidth_deg: float = declare_field(
        0.0, "one-way half-power beamwidth; 0 = not given", "deg", 0.0, 180.0
    )
    elevation_beamwidth_deg: float = declare_field(
        0.0, "one-way half-power beamwidth; 0 = not given", "deg", 0.0, 180.0
    )
    antenna_length: float = declare_field(
        0.0,
        "length of the aperture along the track, in place of azimuth_beamwidth_deg; 0 = not given",
        "m",
        0.0,
        1e5,
    )
    antenna_height: float = declare_field(
        0.0,
        "height of the aperture across the track, in place of elevation_beamwidth_deg; 0 = not given",
        "m",
        0.0,
        1e5,
    )
    gain_db: float = declare_field(0.0, "peak one-way gain", "dB", -100.0, 100.0)
    transmit_power: float = declare_field(1.0, "peak transmit power", "W", 1e-12, 1e12)
    noise_temperature: float = declare_field(
        0.0, "noise temperature of the receiver with its antenna; 0 adds no noise", "K", 0.0, 1e9
    )
    losses_db: float = declare_field(0.0, "two-way system losses", "dB", 0.0, 100.0)
    adc_bits: int = declare_field(
        0,
        "bits of the converter, for I and for Q; uniform steps, best for Gaussian echoes; 0 = no quantisation",
        "",
        0,
        8,
    )
    saturation_db: float | None = declare_field(
        None, "level at which I and Q are clipped, over their rms; default: none", "dB", -20.0, 100.0
    )
    raw_coding: Literal["none", "baq", "fdbaq"] = declare_field(
        "none",
        "block-adaptive quantisation: baq with baq_bits, fdbaq with the 2, 3 or 4 bits that a block needs",
        choices=("none", "baq", "fdbaq"),
    )
    baq_bits: int = declare_field(3, "bits of baq for I and for Q", "", 1, 8)
    baq_block: int = declare_field(128, "samples of a pulse that share a scale", "", 8, 65536)
    fdbaq_margin_db: float = declare_field(
        0.0, "least ratio of thermal noise to the quantisation noise of fdbaq", "dB", -30.0, 30.0
    )
    iq_gain_db: float = declare_field(0.0, "gain of Q over that of I", "dB", -20.0, 20.0)
    iq_phase_deg: float = declare_field(0.0, "angle between Q and I less 90 deg", "deg", -80.0, 80.0)
    iq_offset_i: float = declare_field(0.0, "constant added to I, over the rms of I", "", -100.0, 100.0)
    iq_offset_q: float = declare_field(0.0, "constant added to Q, over the rms of Q", "", -100.0, 100.0)
    phase_noise: str = declare_field(
        "",
        "single-sideband phase noise of the oscillator, frequency:level in Hz and dBc/Hz, such as 10:-60,1000:-100",
    )
    gain_drift_db: float = declare_field(
        0.0, "change of the receiver's gain from the first to the last pulse, even in dB", "dB", -60.0, 60.0
    )
    gain_jitter_db: float = declare_field(
        0.0, "random change of the receiver's gain from pulse to pulse, rms", "dB", 0.0, 20.0
    )
    dead_pulses: float = declare_field(0.0, "share of pulses that are lost, at random", "", 0.0, 0.9)
    transmit_gaps: bool = declare_field(
        False, "the receiver is off while a pulse is transmitted; pri_sequence moves the gaps"
    )
    interference_file: str = declare_field(
        "",
        "CSV of emitters on the ground, one a line",
    )
    transmit_distortion: str = declare_field(
        "",
        "imbalance and cross-talk of the transmitter, complex: t_HH,t_HV,t_VH,t_VV of M = R S T",
    )
    receive_distortion: str = declare_field(
        "",
        "imbalance and cross-talk of the receiver, complex: r_HH,r_HV,r_VH,r_VV of M = R S T",
    )
    mode_parameters: Mapping[str, Value] = field(default_factory=dict)


_GEOMETRY_HINT = "the geometry is given by slant_range, look_angle_deg, heading_deg and aim_x, aim_y, aim_z"

SENSOR = ParamTable(
    plugin="sar_antenna",
    element="sensor",
    doc="Side-looking radar: track, beam, waveform, polarisation, power and an optional separate receiver; may hold "
    "a `range_film`.",
    error=RadarError,
    hints={
        "to_world": _GEOMETRY_HINT,
        "fov": "the beam is given by pattern, azimuth_beamwidth_deg and elevation_beamwidth_deg",
        "aim_point": "give aim_x, aim_y and aim_z as floats, which keep double precision",
        "polarization": 'did you mean "polarisation"?',
    },
    params=params_of(RadarDescription),
    more=mode_parameters,
)


@dataclass(frozen=True, eq=False)
class RadarInput:
    """Validated description of a radar and its film.

    Parameters
    ----------
    sensor, film : their parameters
    sensor_given, film_given : names that were given, the others have their defaults
    where, film_where : start of every error
    folder : base of relative paths of track files
    track : antenna positions in the frame of the geometry, in place of a ``track_file``
    """

    sensor: RadarDescription
    film: FilmDescription
    sensor_given: frozenset[str] = frozenset()
    film_given: frozenset[str] = frozenset()
    where: str = SENSOR.plugin
    film_where: str = FILM.plugin
    folder: Path = Path()
    track: Track | None = None

    @staticmethod
    def read(
        sensor: Mapping[str, object],
        film: Mapping[str, object],
        where: str = SENSOR.plugin,
        film_where: str = FILM.plugin,
        folder: Path = Path(),
        track: Track | None = None,
        *,
        python: bool = False,
    ) -> "RadarInput":
        """Validate parameters that are given by name; ``python`` as for `ParamTable.read`.

        Raises
        ------
        RadarError
            A name is unknown, a value has the wrong type or is out of bounds, or belongs to another mode.
        """
        values = SENSOR.read(sensor, where, python=python)
        own = {p.name: values.pop(p.name) for p in mode_parameters()}
        law = MODES[str(values["mode"])]
        used = {p.name for p in law.parameters}
        for name in own:
            if name in sensor and name not in used:
                owners = " or ".join(mode.name for mode in MODES if name in {p.name for p in mode.parameters})
                raise RadarError(
                    f"{where}: {name} has no effect with mode = {law.name}; take mode = {owners} or leave it out"
                )
        values_of_mode = {name: value for name, value in own.items() if name in used and value is not None}
        description = fill_description(RadarDescription(mode_parameters=values_of_mode), values)
        return RadarInput(
            description,
            fill_description(FilmDescription(), FILM.read(film, film_where, python=python)),
            frozenset(sensor),
            frozenset(film),
            where,
            film_where,
            folder,
            track,
        )

    @staticmethod
    def of(radar: RadarDescription, film: FilmDescription, track: Track | None = None) -> "RadarInput":
        """Validate descriptions made in Python; a field that has its default counts as not given."""
        return RadarInput.read(
            _list_given(radar) | dict(radar.mode_parameters),
            _list_given(film),
            type(radar).__name__,
            type(film).__name__,
            track=track,
            python=True,
        )


def _list_given(description: RadarDescription | FilmDescription) -> dict[str, object]:
    """Fields that differ from their defaults, NumPy scalars as Python's."""
    values = {
        f.name: getattr(description, f.name) for f in fields(description) if f.name != "mode_parameters"
    }
    plain = {name: v.item() if isinstance(v, np.generic) else v for name, v in values.items()}
    defaults = {f.name: f.default for f in fields(description)}
    return {name: v for name, v in plain.items() if v is not defaults[name] and v != defaults[name]}
