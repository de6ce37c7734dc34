"""The parameters of every plugin."""

from sarmitsuba.core.parameters import Param, ParamTable
from sarmitsuba.effects.effect import switchable_effects
from sarmitsuba.loading.material_tables import (
    ABSORBER,
    HOLDER,
    ITU_RADIO_MATERIAL,
    LAND_COVER,
    POINT_SCATTERER,
    RADAR_MATERIAL,
    RADIO_MATERIAL,
)
from sarmitsuba.radar.description import SENSOR
from sarmitsuba.radar.film import FILM
from sarmitsuba.scene.materials.typical import ORDINARY_RMS_HEIGHT
from sarmitsuba.scene.scatterers import SCATTERERS
from sarmitsuba.scene.settings import METHODS, TOLERANCE_DB


def _switches() -> tuple[Param, ...]:
    """Switch parameters of the effects."""
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
            "hybrid: key pulses traced; raw: every pulse traced; image: one look; raster: one bounce",
            choices=tuple(METHODS),
        ),
        Param(
            "max_depth",
            "integer or auto",
            0,
            "largest number n of bounces of a ray; an echo back along its chain has 2 n - 1",
            "",
            0,
            1000,
            auto=True,
        ),
        Param(
            "ray_spacing", "float", 0.0, "distance between rays in the launch plane", "m", 0.0, 1e6, auto=True
        ),
        Param(
            "diffuse_ray_spacing",
            "float",
            0.0,
            "distance between the rays for diffuse scattering; automatic: footprints as large as scatterer_cell, at "
            "least ray_spacing",
            "m",
            0.0,
            1e6,
            auto=True,
        ),
        Param(
            "key_pulse_interval",
            "integer",
            0,
            "number of pulses that share one tracing",
            "",
            0,
            10_000_000,
            auto=True,
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
            "width in samples of the gridding kernel; automatic: the film's",
            "",
            0,
            8,
            auto=True,
        ),
        Param("seed", "integer", 0, "random seed", "", 0, 2**31 - 1),
        Param(
            "pass_days",
            "float",
            0.0,
            "time since the first pass, in days; materials with temporal_coherence below 1 decorrelate over it",
            "days",
            0.0,
            1e5,
        ),
        Param(
            "keep_orders",
            "boolean",
            False,
            "store echoes by their number of bounces, each in its own layers; the last has all beyond",
        ),
        Param(
            "keep_subsets", "boolean", True, "store two independent ray subsets separately, for error bars"
        ),
        Param(
            "phase_precision",
            "string",
            "double",
            "floating-point precision of path lengths and phases",
            choices=("double", "single"),
        ),
        Param(
            "tolerance_db",
            "float",
            TOLERANCE_DB,
            "an effect on auto is left out if it changes the image by less than this, relative to its clutter or peak",
            "dB",
            -200.0,
            -1.0,
        ),
        Param(
            "target_error_db",
            "float",
            0.0,
            "add passes of rays until the sampling error is below this; 0 = off",
            "dB",
            -200.0,
            0.0,
        ),
        Param(
            "time_limit",
            "float",
            0.0,
            "add passes of rays until they have taken this time; planning, final image and files take extra time; 0 "
            "= off",
            "s",
            0.0,
            1e9,
        ),
        Param(
            "default_rms_height",
            "float",
            ORDINARY_RMS_HEIGHT,
            "rms height of Sionna RT's materials without scattering_coefficient; their correlation length is 10 times "
            "that; 0 makes all materials smooth that state no roughness",
            "m",
            0.0,
            0.1,
        ),
        Param(
            "smooth",
            "boolean",
            False,
            "meshes stand for the smooth surface through their corners, to which finer facets are fitted; edges that "
            "bend by more than 40 deg stay sharp",
        ),
        Param(
            "endless_ground",
            "string",
            "auto",
            "whether level ground at the lowest level goes on beyond its rim, which then returns no echo; auto: where "
            "it is wide and surrounds the scene and, if metal, a mesh stands on it; on: any level sheet; off: none",
            choices=("auto", "on", "off"),
        ),
    ),
)

# of the plugins other than kinds of scatterers
TABLES: dict[str, ParamTable] = {
    table.plugin: table
    for table in (
        SENSOR,
        FILM,
        INTEGRATOR,
        RADAR_MATERIAL,
        LAND_COVER,
        POINT_SCATTERER,
        ITU_RADIO_MATERIAL,
        RADIO_MATERIAL,
        ABSORBER,
        HOLDER,
    )
}


def plugin_tables() -> dict[str, ParamTable]:
    """Parameter tables of all plugins, kinds of scatterers included, by name."""
    return TABLES | {kind.name: kind.table for kind in SCATTERERS}


__all__ = [
    "ABSORBER",
    "FILM",
    "HOLDER",
    "INTEGRATOR",
    "ITU_RADIO_MATERIAL",
    "LAND_COVER",
    "POINT_SCATTERER",
    "RADAR_MATERIAL",
    "RADIO_MATERIAL",
    "SENSOR",
    "TABLES",
    "plugin_tables",
]
