"""The parameters of every plugin."""

from sarmitsuba.effects.effect import switchable_effects
from sarmitsuba.errors import RadarError
from sarmitsuba.loader.material_tables import (
    ABSORBER,
    HOLDER,
    ITU_RADIO_MATERIAL,
    POINT_SCATTERER,
    RADAR_MATERIAL,
    RADIO_MATERIAL,
)
from sarmitsuba.loader.parameters import Param, ParamTable
from sarmitsuba.materials.bsdfs import ORDINARY_RMS_HEIGHT
from sarmitsuba.scene.settings import METHODS, TOLERANCE_DB

_GEOMETRY_HINT = "the geometry is given by slant_range, look_angle_deg, heading_deg and aim_x, aim_y, aim_z"

SENSOR = ParamTable(
    plugin="sar_antenna",
    element="sensor",
    doc="Monostatic side-looking radar: track, beam, waveform, polarisation, power; may hold a `range_film`.",
    error=RadarError,
    hints={
        "to_world": _GEOMETRY_HINT,
        "fov": "the beam is given by pattern, azimuth_beamwidth_deg and elevation_beamwidth_deg",
        "aim_point": "give aim_x, aim_y and aim_z as floats, which keep double precision",
        "polarization": 'did you mean "polarisation"?',
    },
    params=(
        Param(
            "mode",
            "string",
            "stripmap",
            "beam fixed to the track, or held on the aim point",
            choices=("stripmap", "spotlight"),
        ),
        Param(
            "slant_range",
            "float",
            10e3,
            "from the antenna at mid-aperture to the aim point",
            "m",
            1.0,
            1e9,
        ),
        Param(
            "look_angle_deg",
            "float",
            45.0,
            "between nadir and the line of sight to the aim point, at mid-aperture",
            "deg",
            0.0,
            89.999,
            positive=True,
        ),
        Param(
            "heading_deg", "float", 0.0, "flight direction, clockwise from north (+y)", "deg", -360.0, 360.0
        ),
        Param(
            "look_side",
            "string",
            "right",
            "side of the flight direction looked to",
            choices=("left", "right"),
        ),
        Param(
            "squint_angle_deg",
            "float",
            0.0,
            "between the line of sight and the plane across the track; positive looks forward",
            "deg",
            -80.0,
            80.0,
        ),
        Param("aim_x", "float", 0.0, "aim point, east, in the file's frame", "m", -1e9, 1e9),
        Param("aim_y", "float", 0.0, "aim point, north, in the file's frame", "m", -1e9, 1e9),
        Param("aim_z", "float", 0.0, "aim point, up, in the file's frame", "m", -1e9, 1e9),
        Param("speed", "float", 100.0, "of the antenna", "m/s", 1e-3, 1e6),
        Param(
            "prf",
            "float",
            0.0,
            "pulse repetition frequency; automatic: 1.25 times the Doppler bandwidth of aperture and image, "
            "or of the beam where that is smaller",
            "Hz",
            0.0,
            1e8,
            auto=True,
        ),
        Param(
            "n_pulses",
            "integer",
            0,
            "pulses in the aperture; automatic: from azimuth_resolution",
            "",
            0,
            10_000_000,
            auto=True,
        ),
        Param(
            "azimuth_resolution",
            "float",
            0.0,
            "azimuth cell lambda R / (2 L cos(squint)) of the aperture length L; automatic: the slant-range "
            "cell, or what n_pulses gives",
            "m",
            0.0,
            1e6,
            auto=True,
        ),
        Param(
            "track_file",
            "string",
            "",
            "CSV of time_s, x_m, y_m, z_m, one pulse a line, in the file's frame; replaces slant_range, "
            "look_angle_deg, heading_deg, squint_angle_deg, speed, prf, n_pulses and azimuth_resolution",
        ),
        Param("center_frequency", "float", 9.6e9, "carrier", "Hz", 1e6, 1e12),
        Param("bandwidth", "float", 300e6, "swept by the pulse", "Hz", 1e3, 1e12),
        Param("pulse_width", "float", 2e-6, "length of the transmitted pulse", "s", 1e-10, 1.0),
        Param(
            "polarisation",
            "string",
            "VV",
            "channels, transmit letter first, separated by commas: HH, HV, VH, VV",
        ),
        Param(
            "pattern",
            "string",
            "isotropic",
            "of the antenna",
            choices=("isotropic", "gaussian", "rectangular"),
        ),
        Param(
            "azimuth_beamwidth_deg",
            "float",
            0.0,
            "one-way half-power width; 0 = not given",
            "deg",
            0.0,
            180.0,
        ),
        Param(
            "elevation_beamwidth_deg",
            "float",
            0.0,
            "one-way half-power width; 0 = not given",
            "deg",
            0.0,
            180.0,
        ),
        Param(
            "antenna_length",
            "float",
            0.0,
            "of a uniform aperture along the track, in place of azimuth_beamwidth_deg; 0 = not given",
            "m",
            0.0,
            1e5,
        ),
        Param(
            "antenna_height",
            "float",
            0.0,
            "of a uniform aperture across, in place of elevation_beamwidth_deg; 0 = not given",
            "m",
            0.0,
            1e5,
        ),
        Param("gain_db", "float", 0.0, "peak one-way gain", "dB", -100.0, 100.0),
        Param("transmit_power", "float", 1.0, "peak", "W", 1e-12, 1e12),
        Param(
            "noise_temperature",
            "float",
            0.0,
            "of the receiver with its antenna; 0 adds no noise",
            "K",
            0.0,
            1e9,
        ),
        Param("losses_db", "float", 0.0, "two-way system losses", "dB", 0.0, 100.0),
    ),
)

FILM = ParamTable(
    plugin="range_film",
    element="film",
    doc="Receive window and sampling of the echoes, and the image to focus from them.",
    error=RadarError,
    hints={
        "width": "the image is given by image_extent_range and pixel_spacing_range",
        "height": "the image is given by image_extent_azimuth and pixel_spacing_azimuth",
    },
    params=(
        Param(
            "near_range",
            "float",
            0.0,
            "slant range of the first sample at mid-aperture; automatic: from image and geometry",
            "m",
            0.0,
            1e9,
            auto=True,
        ),
        Param(
            "far_range",
            "float",
            0.0,
            "slant range of the last sample at mid-aperture; automatic: from image and geometry",
            "m",
            0.0,
            1e9,
            auto=True,
        ),
        Param(
            "sampling_rate",
            "float",
            0.0,
            "complex samples a second; automatic: 1.2 times the bandwidth",
            "Hz",
            0.0,
            1e13,
            auto=True,
        ),
        Param(
            "gridding_width",
            "integer",
            4,
            "samples that one contribution is spread over; each step of 1 gains about 10 dB of accuracy",
            "",
            2,
            16,
        ),
        Param("image_grid", "string", "slant", "coordinates of the image", choices=("slant", "ground")),
        Param(
            "image_center_x", "float", 0.0, "east, in the file's frame; absent: the aim point", "m", -1e9, 1e9
        ),
        Param(
            "image_center_y",
            "float",
            0.0,
            "north, in the file's frame; absent: the aim point",
            "m",
            -1e9,
            1e9,
        ),
        Param(
            "image_height",
            "float",
            0.0,
            "height of the horizontal image plane in the file's frame; absent: the aim point's",
            "m",
            -1e9,
            1e9,
        ),
        Param(
            "image_extent_azimuth",
            "float",
            0.0,
            "size along the track, on the ground; automatic: the geometry with a margin, at most 2048 cells",
            "m",
            0.0,
            1e7,
            auto=True,
        ),
        Param(
            "image_extent_range",
            "float",
            0.0,
            "size across the track, on the ground; automatic: the geometry with its layover and a margin, at "
            "most 2048 cells",
            "m",
            0.0,
            1e7,
            auto=True,
        ),
        Param(
            "pixel_spacing_azimuth",
            "float",
            0.0,
            "automatic: half the azimuth cell",
            "m",
            0.0,
            1e6,
            auto=True,
        ),
        Param(
            "pixel_spacing_range",
            "float",
            0.0,
            "in slant range or on the ground, as image_grid; automatic: half the range cell",
            "m",
            0.0,
            1e6,
            auto=True,
        ),
    ),
)


def _switches() -> tuple[Param, ...]:
    """One switch for every effect that has one, as the effects describe them."""
    return tuple(
        Param(effect.name, "string", "auto", effect.documentation, choices=("auto", "on", "off"))
        for effect in switchable_effects()
    )


INTEGRATOR = ParamTable(
    plugin="sar_path",
    element="integrator",
    doc="Multi-bounce coherent ray tubes. Every effect is `auto` (decided from the scene), `on` or `off`.",
    hints={"rr_depth": "paths end at max_depth", "hide_emitters": "emitters have no meaning for a radar"},
    more=_switches,
    params=(
        Param(
            "method",
            "string",
            "hybrid",
            "every pulse traced (raw), key pulses (hybrid), one look (image), one bounce (raster)",
            choices=tuple(METHODS),
        ),
        Param("max_depth", "integer or auto", 0, "most bounces", "", 0, 1000, auto=True),
        Param("ray_spacing", "float", 0.0, "between rays in the launch plane", "m", 0.0, 1e6, auto=True),
        Param(
            "diffuse_ray_spacing",
            "float",
            0.0,
            "between the rays that find diffuse scatterers; automatic: footprints as large as scatterer_cell, at "
            "least ray_spacing",
            "m",
            0.0,
            1e6,
            auto=True,
        ),
        Param(
            "key_pulse_interval", "integer", 0, "pulses that share one tracing", "", 0, 10_000_000, auto=True
        ),
        Param(
            "scatterer_cell",
            "float",
            0.0,
            "side of the cells that carry one persistent diffuse scatterer",
            "m",
            0.0,
            1e6,
            auto=True,
        ),
        Param(
            "gridding_width",
            "integer",
            0,
            "samples that one contribution is spread over; automatic: the film's",
            "",
            0,
            16,
            auto=True,
        ),
        Param("seed", "integer", 0, "of every random number", "", 0, 2**31 - 1),
        Param("keep_orders", "boolean", False, "keep contributions of different bounce numbers apart"),
        Param("keep_subsets", "boolean", False, "keep two independent ray subsets apart, for error bars"),
        Param(
            "phase_precision",
            "string",
            "double",
            "arithmetic of path lengths and phases",
            choices=("double", "single"),
        ),
        Param(
            "tolerance_db",
            "float",
            TOLERANCE_DB,
            "an effect left to auto is left out where the image changes by less, over its clutter or peak",
            "dB",
            -200.0,
            -1.0,
        ),
        Param("target_error_db", "float", 0.0, "stop refining here; 0 = off", "dB", -200.0, 0.0),
        Param("time_limit", "float", 0.0, "stop tracing after this time; 0 = off", "s", 0.0, 1e9),
        Param(
            "default_rms_height",
            "float",
            ORDINARY_RMS_HEIGHT,
            "roughness of materials that state none: Sionna RT's without scattering_coefficient, Mitsuba's rough ones",
            "m",
            0.0,
            0.1,
        ),
    ),
)

TABLES: dict[str, ParamTable] = {
    table.plugin: table
    for table in (
        SENSOR,
        FILM,
        INTEGRATOR,
        RADAR_MATERIAL,
        POINT_SCATTERER,
        ITU_RADIO_MATERIAL,
        RADIO_MATERIAL,
        ABSORBER,
        HOLDER,
    )
}

__all__ = [
    "ABSORBER",
    "FILM",
    "HOLDER",
    "INTEGRATOR",
    "ITU_RADIO_MATERIAL",
    "POINT_SCATTERER",
    "RADAR_MATERIAL",
    "RADIO_MATERIAL",
    "SENSOR",
    "TABLES",
]
