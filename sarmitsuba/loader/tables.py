"""The parameters of every plugin."""

from sarmitsuba.loader.material_tables import (
    ABSORBER,
    HOLDER,
    ITU_RADIO_MATERIAL,
    POINT_SCATTERER,
    RADAR_MATERIAL,
    RADIO_MATERIAL,
)
from sarmitsuba.loader.radar_parameters import FILM, SENSOR
from sarmitsuba.materials.library import ORDINARY_RMS_HEIGHT
from sarmitsuba.parameters import Param, ParamTable
from sarmitsuba.scene.settings import EFFECT_NAMES, METHODS, TOLERANCE_DB

_EFFECT_DOCS = {
    "fresnel": "reflection coefficients of the materials; off: every surface a perfect conductor",
    "roughness": "coherent reflection reduced by the rms height",
    "coherent": "physical-optics return of the smooth part of the surfaces",
    "diffuse": "incoherent return of rough surfaces",
    "speckle": "persistent random reflectivity of the diffuse scatterers; off: all have the same phase",
    "cross_polarisation": "channels with different transmit and receive polarisation",
    "antenna_pattern": "two-way beam pattern",
    "spreading": "spherical spreading inside the scene",
    "visibility": "test of the way back to the antenna",
    "tube_phase": "phase integral over each ray tube's footprint",
    "diffuse_double": "diffuse return after a mirror chain, with its reciprocal path",
    "footprint_splitting": "ray tubes shared among the scatterer cells that they overlap",
    "noise": "thermal noise of the receiver",
    "depolarisation": "rotation of the polarisation by reflection",
    "trajectory": "deviation of the track from a straight line",
}

INTEGRATOR = ParamTable(
    plugin="sar_path",
    element="integrator",
    doc="Multi-bounce coherent ray tubes. Every effect is `auto` (decided from the scene), `on` or `off`.",
    hints={"rr_depth": "paths end at max_depth", "hide_emitters": "emitters have no meaning for a radar"},
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
        *(
            Param(name, "string", "auto", _EFFECT_DOCS[name], choices=("auto", "on", "off"))
            for name in EFFECT_NAMES
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
