"""The parameters of the material plugins."""

from dataclasses import replace

from sarmitsuba.core.parameters import Param, ParamTable
from sarmitsuba.loading.names_of_materials import exact_kind
from sarmitsuba.scene.materials.change import CHANGE
from sarmitsuba.scene.materials.diffuse_law import LAWS, law_parameters
from sarmitsuba.scene.materials.named.itu_p2040 import ITU_BANDS
from sarmitsuba.scene.materials.named_materials import MATERIALS, material_parameters
from sarmitsuba.scene.materials.texture import GREATEST_SHAPE


def _own_parameters() -> tuple[Param, ...]:
    """Parameters declared by single diffuse laws or named materials."""
    laws = {p: " or ".join(law.name for law in LAWS if p in law.parameters) for p in law_parameters()}
    named = {p: " or ".join(m.name for m in MATERIALS if p in m.parameters) for p in material_parameters()}
    return (
        *(replace(p, doc=f"{p.doc}; for diffuse_law = {names}") for p, names in laws.items()),
        *(replace(p, doc=f"{p.doc}; for material = {names}") for p, names in named.items()),
    )


_EXTENT = Param(
    "map_extent",
    "string",
    "",
    "lays the bitmaps over the scene from above: x and y (m, file frame) of the south-western and of the north-eastern "
    "corner, such as `-50 -50 50 50`; left out: they lie on the mesh's texture coordinates",
)

PERMITTIVITY = (
    Param(
        "material",
        "string",
        "",
        "permittivity by name",
        choices=lambda: tuple(sorted(MATERIALS.names)),
        synonym=exact_kind,
    ),
    Param("permittivity_real", "float", 1.0, "relative permittivity eps', real part", "", 1.0, 1e9),
    Param(
        "permittivity_imag",
        "float",
        0.0,
        "loss eps'' of the relative permittivity eps' - j eps''",
        "",
        0.0,
        1e12,
    ),
    Param("conductivity", "float", 0.0, "conductivity, in place of permittivity_imag", "S/m", 0.0, 1e9),
)

RADAR_MATERIAL = ParamTable(
    plugin="radar_material",
    element="bsdf",
    doc="Surface of a half space, or of a slab where `thickness` is given: `material`, or `permittivity_real` with its "
    "loss or conductivity.",
    hints={
        "reflectance": "radar reflectivity follows from material or permittivity_real, and diffuse_level_db",
        "type": 'did you mean "material"?',
        "roughness": 'did you mean "rms_height"?',
    },
    more=_own_parameters,
    params=(
        *PERMITTIVITY,
        Param(
            "thickness",
            "float",
            0.0,
            "thickness of a slab, which every facet then is (window, partition); 0 = a half space",
            "m",
            0.0,
            100.0,
        ),
        Param(
            "sheet_resistance",
            "float",
            0.0,
            "sheet resistance of a metal coating on the slab's face opposite to the facet's normal; 0 = none",
            "ohm",
            0.0,
            1e9,
        ),
        Param(
            "facet_depth",
            "float",
            0.0,
            "position of the facets in the slab, as a share of its thickness: 0 = at the face on their normals' "
            "side, 0.5 = in the middle, 1 = at the other face",
            "",
            0.0,
            1.0,
        ),
        Param(
            "smooth",
            "boolean",
            False,
            "a mirror, without roughness and diffuse return; else a named material without rms_height, diffuse_law and "
            "diffuse_level_db has its typical ones",
        ),
        Param(
            "rms_height",
            "float",
            0.0,
            "standard deviation of the surface height; without a diffuse_law: small_slope, or iem where the surface is "
            "rough against the wave, with a correlation length of 10 times that unless given",
            "m",
            0.0,
            1e3,
        ),
        Param(
            "diffuse_law",
            "string",
            "none",
            "angular law of the incoherent return",
            choices=lambda: tuple(sorted(LAWS.names)),
        ),
        Param(
            "diffuse_level_db",
            "float",
            -20.0,
            "level of the empirical laws; its quantity depends on diffuse_law",
            "dB",
            -200.0,
            60.0,
        ),
        Param("correlation_length", "float", 0.0, "correlation length of the surface height", "m", 0.0, 1e3),
        Param(
            "cross_polar_ratio_db",
            "float",
            -300.0,
            "ratio of cross-polar to co-polar diffuse power; -300 = none",
            "dB",
            -300.0,
            0.0,
        ),
        Param(
            "texture_shape",
            "float",
            0.0,
            "shape nu of the gamma texture of the diffuse return (K-distributed clutter), mean 1; 0 = none",
            "",
            0.0,
            GREATEST_SHAPE,
        ),
        Param(
            "texture_length",
            "float",
            0.0,
            "correlation length of that texture, where its autocorrelation falls to 1/e",
            "m",
            0.0,
            1e6,
        ),
        _EXTENT,
        Param(
            "sigma0_map_range",
            "string",
            "",
            "dB on sigma0 at a pixel of 0 and of 1, such as `-10 5`; left out: the pixel is the factor itself",
        ),
        Param(
            "permittivity_map_range",
            "string",
            "",
            "permittivity eps' at a pixel of 0 and of 1 (the loss tangent stays); left out: the pixel itself",
        ),
        Param(
            "roughness_map_range",
            "string",
            "",
            "rms height at a pixel of 0 and of 1, m; left out: the pixel itself",
        ),
        *CHANGE,
    ),
)

LAND_COVER = ParamTable(
    plugin="land_cover",
    element="bsdf",
    doc="Many materials on one mesh, by a bitmap of classes: a texture `bitmap` under the name `class_map`, and a "
    "material for each class under `class_N` (grey value N) or `color_RRGGBB`.",
    params=(_EXTENT,),
)

POINT_SCATTERER = ParamTable(
    plugin="point_scatterer",
    element="bsdf",
    doc="On a `sphere` shape: its centre becomes an ideal isotropic scatterer; the sphere is not traced.",
    params=(
        Param("rcs_dbsm", "float", 0.0, "radar cross section", "dBsm", -200.0, 200.0),
        Param("phase_deg", "float", 0.0, "phase of its reflectivity", "deg", -360.0, 360.0),
    ),
)

_COLORS = tuple(
    Param(name, "ignored", "", "colour on the screen; no effect")
    for name in ("color", "reflectance", "base_color")
)
_SCATTERING = (
    Param("thickness", "float", 0.1, "read but not used: surfaces are half spaces here", "m", 0.0, 1e9),
    Param(
        "scattering_coefficient",
        "float",
        0.0,
        "S: share S^2 of the power reflected at the true angle and polarisation is scattered",
        "",
        0.0,
        1.0,
    ),
    Param("xpd_coefficient", "float", 0.0, "share of the scattered power that is cross-polar", "", 0.0, 1.0),
    Param(
        "scattering_pattern",
        "string",
        "lambertian",
        "directions of the scattered power",
        choices=("lambertian", "directive", "backscattering"),
    ),
    Param("alpha_r", "integer", 1, "exponent of the lobe about the mirror direction", "", 1, 200),
    Param("alpha_i", "integer", 1, "exponent of the lobe back to the source; of backscattering", "", 1, 200),
    Param("lambda_", "float", 1.0, "share of the first of these lobes; of backscattering", "", 0.0, 1.0),
    *_COLORS,
)

ITU_RADIO_MATERIAL = ParamTable(
    plugin="itu-radio-material",
    element="bsdf",
    doc="Sionna RT's ITU material.",
    params=(Param("type", "string", "", "material of ITU-R P.2040", choices=tuple(ITU_BANDS)), *_SCATTERING),
)

RADIO_MATERIAL = ParamTable(
    plugin="radio-material",
    element="bsdf",
    doc="Sionna RT's general material.",
    params=(
        Param("relative_permittivity", "float", 1.0, "real part", "", 1.0, 1e9),
        Param("conductivity", "float", 0.0, "", "S/m", 0.0, 1e9),
        *_SCATTERING,
    ),
)

ABSORBER = ParamTable(
    plugin="absorber-radio-material",
    element="bsdf",
    doc="Sionna RT's perfect absorber: blocks and returns nothing.",
    params=_COLORS,
)

HOLDER = ParamTable(
    plugin="holder-material",
    element="bsdf",
    doc="Sionna RT's wrapper around one nested material, whose meaning it takes.",
    params=(),
)
