"""Typical roughness and clutter level of the named materials."""

import math
from dataclasses import replace

from sarmitsuba.core.constants import SPEED_OF_LIGHT
from sarmitsuba.scene.materials.diffuse_law import LAWS
from sarmitsuba.scene.materials.material import Material
from sarmitsuba.scene.materials.named_materials import MATERIALS, Typical

# rms height of Sionna RT's materials, m: plastered and concrete walls have 0.3 to 3 mm
ORDINARY_RMS_HEIGHT = 1e-3
# Correlation length over rms height of the same: bare soils measure 8 to 31 (s = 3.2 to 11 mm, l = 84 to 99 mm; Oh,
# Sarabandi and Ulaby, IEEE TGRS 30 (2) 1992), 3 where they are freshly ploughed; a ratio is the same in every band
ORDINARY_CORRELATION = 10.0
# Hz, of the gamma values
GAMMA_FREQUENCY = 10e9

# rad, incidence at which metal scatters what its mirror loses
_LOSS_ANGLE = math.radians(40.0)

# k s up to which the laws of a height spectrum are used without being asked for
_MOST_KS_SMALL_SLOPE, _MOST_KS_IEM = 1.0, 3.0

# of materials without an own entry: plaster, boards, plastic
OTHER = Typical(0.003, "lambert", -13.0)
IDEAL = Typical(0.0, "none", 0.0)
# Sheets and bodywork: far smoother than 1 mm, which stands for rivets, seams and dirt
METAL = Typical(0.001, "lambert", -4.0, absorbs=False)
TYPICAL: dict[str, Typical] = {
    "vacuum": IDEAL,
    "pec": IDEAL,
    "concrete": Typical(0.003, "lambert", -13.0),
    "brick": Typical(0.008, "lambert", -8.0),
    "metal": METAL,
    "glass": Typical(0.0005, "lambert", -30.0),
    "window_glass": Typical(0.0005, "lambert", -30.0),
    "low_e_glass": Typical(0.0005, "lambert", -30.0),
    "clear_acrylic": Typical(0.0005, "lambert", -30.0),
    "wood": Typical(0.005, "lambert", -12.0),
    "fresh_wood": Typical(0.002, "lambert", -15.0),
    "marble": Typical(0.002, "lambert", -15.0),
    "asphalt_concrete": Typical(0.003, "constant_gamma", -23.0),
    "very_dry_ground": Typical(0.02, "constant_gamma", -13.0),
    "medium_dry_ground": Typical(0.02, "constant_gamma", -11.0),
    "wet_ground": Typical(0.02, "constant_gamma", -9.0),
    "fresh_water": Typical(0.002, "constant_gamma", -30.0),
    "sea_water": Typical(0.002, "constant_gamma", -30.0),
}


def typical_of(kind: str) -> Typical:
    """Typical surface of a named material: its own, else that of this table."""
    return MATERIALS[kind].typical or TYPICAL.get(kind, OTHER)


def typical_surface(kind: str, frequency: float, rms_height: float = ORDINARY_RMS_HEIGHT) -> Material:
    r"""Typical roughness and diffuse law of a named material, its permittivity to be filled in.

    .. math:: \gamma(f) = \gamma_0 + 5 \log_{10}(f / 10\,\mathrm{GHz}) \text{ dB}

    Parameters
    ----------
    kind : name in ``MATERIALS``
    frequency : Hz
    rms_height : m, ``default_rms_height`` of the scene; 0 makes every material smooth

    Notes
    -----
    Levels are of the X band and spread by 5 dB and more from place to place, with moisture, growth and wear; those of
    ``lambert`` are the same at every frequency but for metal, which absorbs nothing: its level is at least that of the
    power which the mirror loses to the roughness. Ignores cross-polarisation, texture and polarisation.

    References
    ----------
    Barton, Land clutter models for radar design and analysis, Proc. IEEE 73 (2) 1985 (frequency dependence); see
    docs/materials.md for the levels.
    """
    typical = typical_of(kind)
    if rms_height == 0.0 or typical.smooth:
        return smooth()
    return replace(
        smooth(),
        rms_height=typical.rms_height,
        diffuse_law=typical.law,
        diffuse_level_db=_level(typical, frequency, typical.rms_height),
    )


def assumed_law(kind: str, rms_height: float, correlation_length: float, frequency: float) -> Material:
    """Surface of a stated rms height (m, above 0) without a diffuse law.

    `rough` up to k s = 1, the integral-equation model up to 3, and beyond, where no height spectrum is known to hold,
    the typical law and level of the material ``kind`` (empty: of none).

    Parameters
    ----------
    correlation_length : m; 0: ``ORDINARY_CORRELATION`` rms heights
    frequency : Hz
    """
    surface = rough(rms_height)
    surface = replace(surface, correlation_length=correlation_length or surface.correlation_length)
    ks = 2.0 * math.pi * frequency / SPEED_OF_LIGHT * rms_height
    if ks <= _MOST_KS_SMALL_SLOPE:
        return surface
    if ks <= _MOST_KS_IEM:
        return replace(surface, diffuse_law="iem")
    typical = typical_of(kind) if kind else OTHER
    typical = TYPICAL["metal"] if typical.smooth else typical
    return replace(
        surface,
        diffuse_law=typical.law,
        diffuse_level_db=_level(typical, frequency, rms_height),
        correlation_length=0.0,
    )


def _level(typical: Typical, frequency: float, rms_height: float) -> float:
    r"""Level of a typical surface at a frequency, dB; of metal at least that of all power that its mirror loses.

    .. math:: L = 4\,(1 - e^{-(2 k s \cos\theta)^2}), \quad \theta = 40°
    """
    if typical.law == "constant_gamma":
        return typical.level_db + 5.0 * math.log10(frequency / GAMMA_FREQUENCY)
    if typical.absorbs:
        return typical.level_db
    k = 2.0 * math.pi * frequency / SPEED_OF_LIGHT
    lost = -math.expm1(-((2.0 * k * rms_height * math.cos(_LOSS_ANGLE)) ** 2))
    return max(typical.level_db, 10.0 * math.log10(4.0 * lost)) if lost > 0.0 else typical.level_db


def surface_words(surface: Material) -> str:
    """Text of an assumed surface, for notes."""
    of = f" at {surface.diffuse_level_db:.3g} dB" if LAWS[surface.diffuse_law].level else ""
    length = (
        f", correlation length {1e3 * surface.correlation_length:g} mm" if surface.correlation_length else ""
    )
    return f"diffuse_law {surface.diffuse_law}{of}, rms height {1e3 * surface.rms_height:g} mm{length}"


def smooth() -> Material:
    """Smooth surface without diffuse law, its permittivity to be filled in."""
    return Material("smooth")


def rough(rms_height: float) -> Material:
    """Rough surface from the rms height alone, m; 0 is a smooth one.

    The small-slope law with a correlation length of ``ORDINARY_CORRELATION`` rms heights: the power lost in specular
    direction is scattered into a lobe about it and, by Bragg scattering, to the radar, vv above hh.
    """
    if rms_height == 0.0:
        return smooth()
    length = ORDINARY_CORRELATION * rms_height
    return replace(smooth(), rms_height=rms_height, correlation_length=length, diffuse_law="small_slope")
