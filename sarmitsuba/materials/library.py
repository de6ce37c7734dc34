"""Permittivity of building materials and ground, and the radar meaning of every kind of material."""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from sarmitsuba.constants import SPEED_OF_LIGHT, VACUUM_PERMITTIVITY
from sarmitsuba.errors import SceneError
from sarmitsuba.materials.material import Material

# ITU-R P.2040-3, table 3; the last four names and the bands above 110 GHz from P.2040-4.
# name: ((from GHz, to GHz, a, b, c, d), ...)
ITU_BANDS: dict[str, tuple[tuple[float, float, float, float, float, float], ...]] = {
    "vacuum": ((0.001, 100.0, 1.0, 0.0, 0.0, 0.0),),
    "concrete": ((1.0, 100.0, 5.24, 0.0, 0.0462, 0.7822), (110.0, 330.0, 5.17, 0.0, 0.0145, 1.0900)),
    "brick": ((1.0, 40.0, 3.91, 0.0, 0.0238, 0.16), (110.0, 330.0, 4.15, 0.0, 0.0006, 1.5712)),
    "plasterboard": ((1.0, 100.0, 2.73, 0.0, 0.0085, 0.9395), (110.0, 330.0, 2.56, 0.0, 0.0001, 1.7799)),
    "wood": ((0.001, 100.0, 1.99, 0.0, 0.0047, 1.0718), (110.0, 330.0, 1.82, 0.0, 0.0040, 1.0761)),
    "glass": ((0.1, 100.0, 6.31, 0.0, 0.0036, 1.3394), (220.0, 450.0, 5.79, 0.0, 0.0004, 1.658)),
    "ceiling_board": ((1.0, 100.0, 1.48, 0.0, 0.0011, 1.0750), (220.0, 450.0, 1.52, 0.0, 0.0029, 1.029)),
    "chipboard": ((1.0, 100.0, 2.58, 0.0, 0.0217, 0.7800), (100.0, 200.0, 2.16, 0.0, 0.0023, 1.359)),
    "plywood": ((1.0, 40.0, 2.71, 0.0, 0.33, 0.0), (110.0, 330.0, 1.94, 0.0, 0.0067, 0.9982)),
    "marble": ((1.0, 60.0, 7.074, 0.0, 0.0055, 0.9262), (110.0, 330.0, 7.94, 0.0, 0.0001, 1.7330)),
    "floorboard": ((50.0, 100.0, 3.66, 0.0, 0.0044, 1.3515), (100.0, 400.0, 3.1575, 0.0, 0.001675, 1.32775)),
    "metal": ((1.0, 100.0, 1.0, 0.0, 1e7, 0.0),),
    "very_dry_ground": ((1.0, 10.0, 3.0, 0.0, 0.00015, 2.52),),
    "medium_dry_ground": ((1.0, 10.0, 15.0, -0.1, 0.035, 1.63),),
    "wet_ground": ((1.0, 10.0, 30.0, -0.4, 0.15, 1.30),),
    "clear_acrylic": ((110.0, 330.0, 2.58, 0.0, 0.0001, 1.6524),),
    "vinyl_tile": ((1.0, 40.0, 3.62, 0.0, 0.0051, 0.8422),),
    "carpet_tile": ((1.0, 40.0, 2.08, 0.0, 0.0009, 0.8200),),
    "asphalt_concrete": ((1.0, 40.0, 4.83, 0.0, 0.0108, 1.3969),),
}

_NO_LEVEL_DB = -300.0  # written in XML for "none"
# Rms height given to ordinary rough BSDFs, m: plastered and concrete walls measure 0.3 to 3 mm
ORDINARY_RMS_HEIGHT = 1e-3
_LEVEL_LAWS = ("lambert", "constant", "constant_gamma")
_SPECTRUM_LAWS = ("kirchhoff", "small_perturbation", "iem")


def permittivity_from_conductivity(real: float, conductivity: float, frequency: float) -> complex:
    r"""Relative permittivity of a lossy material.

    .. math:: \epsilon = \epsilon' - j \sigma / (2 \pi f \epsilon_0)

    Parameters
    ----------
    real : relative permittivity, real part
    conductivity : S/m
    frequency : Hz
    """
    return complex(real, -conductivity / (2.0 * math.pi * frequency * VACUUM_PERMITTIVITY))


def itu_permittivity(name: str, frequency: float) -> tuple[complex, str]:
    r"""Relative permittivity of an ITU-R P.2040-3 material.

    .. math:: \epsilon' = a f_\mathrm{GHz}^b, \quad \sigma = c f_\mathrm{GHz}^d

    Parameters
    ----------
    name : key of ``ITU_BANDS``
    frequency : Hz

    Returns
    -------
    permittivity : complex, ``eps' - j eps''``
    note : empty, or one line saying that the frequency lies outside the measured bands and which one was used

    Notes
    -----
    Ignores moisture and temperature; outside its bands the nearest one is extrapolated.

    References
    ----------
    ITU-R P.2040-3, equations 28 and 29 with table 3.
    """
    ghz = frequency / 1e9
    bands = ITU_BANDS[name]
    low, high, a, b, c, d = min(bands, key=lambda band: max(band[0] - ghz, ghz - band[1], 0.0))
    note = ""
    if not low <= ghz <= high:
        note = f"ITU-R P.2040 gives {name} from {low:g} to {high:g} GHz; extrapolated to {ghz:g} GHz"
    return permittivity_from_conductivity(a * ghz**b, c * ghz**d, frequency), note


def itu_material(name: str, kind: str, frequency: float, **surface: Any) -> tuple[Material, str]:
    """Material of an ITU name with further fields, and the note of `itu_permittivity`."""
    eps, note = itu_permittivity(kind, frequency)
    return _material(name, eps, **surface), note


def radar_material(
    name: str, values: Mapping[str, Any], given: frozenset[str], frequency: float, where: str
) -> tuple[Material, str]:
    """Material of a validated ``radar_material`` element.

    Parameters
    ----------
    name : unique in the scene
    values : every parameter of the table
    given : names that the file sets
    frequency : Hz
    where : start of every error

    Returns
    -------
    material, and a note (may be empty)
    """
    _exclusive(given, where)
    law, rms = values["diffuse_law"], values["rms_height"]
    if law in _SPECTRUM_LAWS and (rms <= 0.0 or values["correlation_length"] <= 0.0):
        raise SceneError(
            f"{where}: diffuse_law = {law} needs rms_height and correlation_length above 0 m, "
            f"got {rms:g} m and {values['correlation_length']:g} m; give both or take another law"
        )
    if "diffuse_level_db" in given and law not in _LEVEL_LAWS:
        raise SceneError(
            f"{where}: diffuse_level_db = {values['diffuse_level_db']:g} dB has no effect with "
            f"diffuse_law = {law}; take one of {', '.join(_LEVEL_LAWS)} or leave it out"
        )
    ratio = values["cross_polar_ratio_db"]
    surface = {
        "rms_height": rms,
        "diffuse_law": law,
        "diffuse_level_db": values["diffuse_level_db"] if law in _LEVEL_LAWS else -np.inf,
        "correlation_length": values["correlation_length"],
        "cross_polar_ratio_db": -np.inf if ratio <= _NO_LEVEL_DB else ratio,
    }
    kind = values["material"]
    if kind == "pec":
        return Material(name, pec=True, **surface), ""
    if kind:
        return itu_material(name, kind, frequency, **surface)
    if "conductivity" in given:
        eps = permittivity_from_conductivity(values["permittivity_real"], values["conductivity"], frequency)
    else:
        eps = complex(values["permittivity_real"], -values["permittivity_imag"])
    return _material(name, eps, **surface), ""


def sionna_material(
    name: str,
    plugin: str,
    values: Mapping[str, Any],
    given: frozenset[str],
    frequency: float,
    rms_height: float = ORDINARY_RMS_HEIGHT,
) -> tuple[Material, str]:
    r"""Material of a validated ``itu-radio-material``, ``radio-material`` or ``absorber-radio-material``.

    Sionna takes the share S^2 of the reflected power out of the mirror direction and scatters it. Here it
    is Lambert's law of albedo S^2 \|R(0)\|^2 and the rms height that loses S^2 at normal incidence. A material
    that gives no scattering coefficient says nothing of its roughness and gets ``rms_height`` (m).

    Notes
    -----
    Ignores the slab's thickness (surfaces are half spaces) and the shape of directive scattering lobes.
    """
    if plugin == "absorber-radio-material":
        return Material(name, permittivity=1.0 + 0.0j), ""
    note = ""
    if plugin == "itu-radio-material":
        eps, note = itu_permittivity(values["type"], frequency)
    else:
        eps = permittivity_from_conductivity(
            values["relative_permittivity"], values["conductivity"], frequency
        )
    if "scattering_coefficient" in given or rms_height == 0.0:
        return _material(name, eps, **scattering_surface(values, eps, frequency)), note
    return _material(name, eps, **rough(rms_height)), note or _rough_note(plugin, rms_height)


def scattering_surface(values: Mapping[str, Any], eps: complex, frequency: float) -> dict[str, Any]:
    """Fields of `Material` that stand for Sionna's scattering and cross-polarisation coefficients."""
    share = min(float(values["scattering_coefficient"]) ** 2, 0.999)
    if share == 0.0:
        return {}
    k = 2.0 * math.pi * frequency / SPEED_OF_LIGHT
    root = np.sqrt(eps)
    albedo = share * abs((1.0 - root) / (1.0 + root)) ** 2
    cross = min(float(values["xpd_coefficient"]), 0.5)
    return {
        # exp(-4 (k s)^2) = 1 - S^2
        "rms_height": math.sqrt(-math.log1p(-share) / 4.0) / k,
        "diffuse_law": "lambert",
        "diffuse_level_db": 10.0 * math.log10(max(4.0 * albedo, 1e-30)),
        "cross_polar_ratio_db": 10.0 * math.log10(cross / (1.0 - cross)) if cross > 0.0 else -np.inf,
    }


def sionna_itu_name(identifier: str) -> str:
    """ITU material that an id such as ``mat-itu_concrete`` names (Sionna RT's rule), else an empty string."""
    name = identifier[4:] if identifier.startswith("mat-") else identifier
    if not name.startswith(("itu_", "itu-")):
        return ""
    return name[4:] if name[4:] in ITU_BANDS else ""


def rough(rms_height: float) -> dict[str, Any]:
    """Fields of `Material` of a rough surface that scatters what its mirror direction loses; none when smooth."""
    return {"rms_height": rms_height, "diffuse_law": "roughness"} if rms_height > 0.0 else {}


def _rough_note(plugin: str, rms_height: float) -> str:
    return (
        f'BSDF "{plugin}" gives no scattering_coefficient and gets an rms height of {1e3 * rms_height:g} mm; '
        f"set default_rms_height of sar_path for another, 0 for smooth"
    )


# Radar meaning of Mitsuba's BSDFs: plugin: (itu name or pec, rough, words for warning and documentation)
ORDINARY_BSDFS: dict[str, tuple[str, bool, str]] = {
    "diffuse": ("concrete", True, "concrete, rms height 1 mm"),
    "conductor": ("pec", False, "smooth perfect conductor"),
    "roughconductor": ("pec", True, "perfect conductor, rms height 1 mm"),
    "dielectric": ("glass", False, "smooth glass, as a half space"),
    "thindielectric": ("glass", False, "smooth glass, as a half space"),
    "roughdielectric": ("glass", True, "glass as a half space, rms height 1 mm"),
    "plastic": ("plastic", False, "smooth plastic of permittivity 2.25"),
    "roughplastic": ("plastic", True, "plastic of permittivity 2.25, rms height 1 mm"),
    "pplastic": ("plastic", True, "plastic of permittivity 2.25, rms height 1 mm"),
    "principled": (
        "principled",
        True,
        "perfect conductor if metallic > 0.5, glass if spec_trans > 0.5, else concrete; rms height 1 mm",
    ),
    "principledthin": ("principled", True, "glass where spec_trans > 0.5, else concrete; rms height 1 mm"),
    "measured": ("concrete", True, "concrete, rms height 1 mm"),
    "measured_polarized": ("concrete", True, "concrete, rms height 1 mm"),
    "hair": ("vacuum", False, "invisible"),
    "null": ("vacuum", False, "invisible"),
    "retarder": ("vacuum", False, "invisible"),
    "circular": ("vacuum", False, "invisible"),
    "polarizer": ("vacuum", False, "invisible"),
}

# BSDFs around another one: plugin: words
ADAPTER_BSDFS: dict[str, str] = {
    "twosided": "its nested BSDF; every surface is two-sided for a radar",
    "bumpmap": "its nested BSDF; the relief is ignored",
    "normalmap": "its nested BSDF; the relief is ignored",
    "mask": "its nested BSDF, invisible if opacity is a number below 0.5; an opacity texture is ignored",
    "blendbsdf": "its first nested BSDF where the weight is below 0.5 or a texture, else the second",
}


def ordinary_material(
    name: str,
    plugin: str,
    values: Mapping[str, Any],
    frequency: float,
    rms_height: float = ORDINARY_RMS_HEIGHT,
) -> tuple[Material, str]:
    """Material that stands for one of Mitsuba's own BSDFs, with the warning that says so.

    Parameters
    ----------
    name : unique in the scene
    plugin : BSDF plugin; an unknown one is read as concrete
    values : its properties (only ``metallic`` and ``spec_trans`` of ``principled`` matter)
    frequency : Hz

    Notes
    -----
    Colours and optical roughness say nothing about centimetre waves and are ignored.
    """
    kind, is_rough, words = ORDINARY_BSDFS.get(plugin, ("concrete", True, "concrete, rms height 1 mm"))
    words = words.replace("rms height 1 mm", f"rms height {1e3 * rms_height:g} mm")
    note = f'BSDF "{plugin}" has no radar parameters and is read as: {words}; give radar_material for better'
    surface: dict[str, Any] = rough(rms_height) if is_rough else {}
    if kind == "principled":
        kind = (
            "pec"
            if _above_half(values, "metallic")
            else "glass"
            if _above_half(values, "spec_trans")
            else "concrete"
        )
    if kind == "pec":
        return Material(name, pec=True, **surface), note
    if kind == "plastic":
        return _material(name, 2.25 - 0.01j, **surface), note
    return itu_material(name, kind, frequency, **surface)[0], note


def adapter_note(plugin: str) -> str:
    """Warning about a BSDF that wraps another one."""
    return f'BSDF "{plugin}" is read as {ADAPTER_BSDFS[plugin]}'


def _above_half(values: Mapping[str, Any], key: str) -> bool:
    value = values.get(key, 0.0)
    return isinstance(value, int | float) and value > 0.5


def _material(name: str, eps: complex, **surface: Any) -> Material:
    """Material of a permittivity; vacuum without a diffuse return is invisible."""
    invisible = eps == 1.0 and surface.get("diffuse_law", "none") in ("none", "roughness")
    return Material(name, permittivity=eps, invisible=invisible, **surface)


def _exclusive(given: frozenset[str], where: str) -> None:
    if not given & {"material", "permittivity_real"}:
        raise SceneError(
            f"{where}: neither material nor permittivity_real is given; give one, for example "
            f'<string name="material" value="concrete"/>'
        )
    for first, second in (
        ("material", "permittivity_real"),
        ("material", "permittivity_imag"),
        ("material", "conductivity"),
        ("permittivity_imag", "conductivity"),
    ):
        if first in given and second in given:
            raise SceneError(f"{where}: {first} and {second} exclude each other; leave one out")


__all__ = [
    "ADAPTER_BSDFS",
    "ITU_BANDS",
    "ORDINARY_BSDFS",
    "adapter_note",
    "itu_material",
    "itu_permittivity",
    "ordinary_material",
    "permittivity_from_conductivity",
    "radar_material",
    "scattering_surface",
    "sionna_itu_name",
    "sionna_material",
]
