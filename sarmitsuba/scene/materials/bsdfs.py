"""Radar materials from BSDFs: those of this package, Sionna RT's and Mitsuba's."""

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from sarmitsuba.core.constants import SPEED_OF_LIGHT
from sarmitsuba.core.errors import SceneError
from sarmitsuba.core.parameters import Value, did_you_mean, float_value, string_value
from sarmitsuba.core.units import db_from_power
from sarmitsuba.scene.materials.change import change_of
from sarmitsuba.scene.materials.diffuse_law import LAWS, DiffuseLaw, law_parameters
from sarmitsuba.scene.materials.material import Dispersion, Material
from sarmitsuba.scene.materials.named.itu_p2040 import ITU_BANDS
from sarmitsuba.scene.materials.named_materials import (
    MATERIALS,
    material_parameters,
    permittivity_from_conductivity,
)
from sarmitsuba.scene.materials.texture import check_texture
from sarmitsuba.scene.materials.typical import (
    ORDINARY_CORRELATION,
    ORDINARY_RMS_HEIGHT,
    assumed_law,
    rough,
    smooth,
    surface_words,
    typical_surface,
)

_NO_LEVEL_DB = -300.0  # written in XML for "none"
_MOST_CROSS = 0.5  # largest cross-polar share of the scattered power


def named_material(
    name: str,
    kind: str,
    frequency: float,
    surface: Material | None = None,
    values: Mapping[str, float] | None = None,
) -> tuple[Material, str]:
    """Material of a registered name, and the note of its permittivity.

    Parameters
    ----------
    name : unique in the scene
    kind : name in ``MATERIALS``
    frequency : Hz
    surface : source of its roughness and diffuse law; None for a smooth one
    values : of the material's parameters; missing ones have their defaults
    """
    entry, surface = MATERIALS[kind].at(values or {}), surface or smooth()
    if entry.thickness and not surface.thickness:
        surface = replace(surface, thickness=entry.thickness)
    if entry.sheet_resistance and not surface.sheet_resistance:
        surface = replace(surface, sheet_resistance=entry.sheet_resistance)
    if entry.pec:
        return replace(surface, name=name, pec=True), ""
    surface = replace(surface, dispersion=Dispersion(kind, tuple(sorted((values or {}).items()))))
    return _material(name, entry.permittivity(frequency), surface), entry.note(frequency)


def radar_material(
    name: str,
    values: Mapping[str, Value | None],
    given: frozenset[str],
    frequency: float,
    where: str,
    rms_height: float = ORDINARY_RMS_HEIGHT,
) -> tuple[Material, str, str]:
    """Material of a validated ``radar_material`` element.

    Without roughness, diffuse law and level a named material has its typical surface; an rms height without a law has
    that of `assumed_law`.

    Parameters
    ----------
    name : unique in the scene
    values : every parameter of the table
    given : names that the file sets
    frequency : Hz
    where : start of every error message
    rms_height : m, ``default_rms_height`` of the scene; 0: no typical surfaces, every one is as the file says

    Returns
    -------
    material, a warning and a note about the surface assumed (both may be empty)
    """
    refuse_two_permittivities(given, where)
    values, assumed = _add_assumed(values, given, frequency, where, rms_height)
    law = LAWS[string_value(values, "diffuse_law")]
    _check_law(law, values, given, where)
    _check_texture(values, law, where)
    ratio = float_value(values, "cross_polar_ratio_db")
    stays, days = change_of(values, given, where, law.temporal_coherence)
    surface = Material(
        name,
        rms_height=float_value(values, "rms_height"),
        diffuse_law=law.name,
        diffuse_level_db=float_value(values, "diffuse_level_db") if law.level else -np.inf,
        correlation_length=float_value(values, "correlation_length"),
        cross_polar_ratio_db=-np.inf if ratio <= _NO_LEVEL_DB else ratio,
        temporal_coherence=stays,
        decorrelation_days=days,
        law_parameters=tuple((p.name, float_value(values, p.name)) for p in law.parameters),
        texture_shape=float_value(values, "texture_shape"),
        texture_length=float_value(values, "texture_length"),
        thickness=float_value(values, "thickness"),
        sheet_resistance=float_value(values, "sheet_resistance"),
        facet_depth=float_value(values, "facet_depth"),
    )
    _check_slab(surface, string_value(values, "material"), where)
    kind = string_value(values, "material")
    own = _own_values(kind, values, given, where)
    if kind:
        return (*named_material(name, kind, frequency, surface, own), assumed)
    if "conductivity" in given:
        real, conductivity = (float_value(values, key) for key in ("permittivity_real", "conductivity"))
        surface = replace(surface, dispersion=Dispersion(real=real, conductivity=conductivity))
    return _material(name, given_permittivity(values, given, frequency), surface), "", assumed


def _add_assumed(
    values: Mapping[str, Value | None], given: frozenset[str], frequency: float, where: str, rms_height: float
) -> tuple[Mapping[str, Value | None], str]:
    """Values with the surface assumed where the file gives none or half of one, and the note about it."""
    kind, height = string_value(values, "material"), float_value(values, "rms_height")
    law_given = bool(given & {"diffuse_law", "diffuse_level_db"})
    if values["smooth"]:
        law = string_value(values, "diffuse_law")
        other = (
            f"rms_height = {height:g} m" if height > 0.0 else f"diffuse_law = {law}" if law != "none" else ""
        )
        if other:
            raise SceneError(f"{where}: smooth and {other} exclude each other; leave one out")
        return values, ""
    if height > 0.0 and not law_given:
        surface = assumed_law(kind, height, float_value(values, "correlation_length"), frequency)
        return {**values, **_values_of(surface)}, (
            f"an rms height without diffuse_law has {surface_words(surface)}; none leaves the coherent loss alone"
        )
    if law_given or "rms_height" in given:
        return values, ""
    if not kind:
        eps = given_permittivity(values, given, frequency)
        return values, "" if eps == 1.0 else "a smooth mirror: give rms_height for a rough surface, or smooth"
    surface = typical_surface(kind, frequency, rms_height)
    if not surface.scatters:
        return values, ""
    note = f"{kind} has its typical surface, {surface_words(surface)}; smooth makes it a mirror"
    return {**values, **_values_of(surface)}, note


def _values_of(surface: Material) -> dict[str, Value]:
    """Parameters of ``radar_material`` of an assumed surface."""
    level = surface.diffuse_level_db if LAWS[surface.diffuse_law].level else -20.0
    return {
        "rms_height": surface.rms_height,
        "correlation_length": surface.correlation_length,
        "diffuse_law": surface.diffuse_law,
        "diffuse_level_db": level,
    }


def _own_values(
    kind: str, values: Mapping[str, Value | None], given: frozenset[str], where: str
) -> dict[str, float]:
    """Given values of a named material's parameters; SceneError for parameters of other materials."""
    known = MATERIALS[kind].parameters if kind else ()
    for parameter in material_parameters():
        if parameter.name in given and parameter not in known:
            takers = ", ".join(sorted(entry.name for entry in MATERIALS if parameter in entry.parameters))
            raise SceneError(
                f'{where}: {parameter.name} has no effect with material = "{kind}"; take {takers} or leave it out'
            )
    return {p.name: float_value(values, p.name) for p in known if p.name in given}


def given_permittivity(
    values: Mapping[str, Value | None], given: frozenset[str], frequency: float
) -> complex:
    """Permittivity from ``permittivity_real`` with its loss or conductivity."""
    real = float_value(values, "permittivity_real")
    if "conductivity" in given:
        return permittivity_from_conductivity(real, float_value(values, "conductivity"), frequency)
    return complex(real, -float_value(values, "permittivity_imag"))


def sionna_material(
    name: str,
    plugin: str,
    values: Mapping[str, Value | None],
    given: frozenset[str],
    frequency: float,
    rms_height: float = ORDINARY_RMS_HEIGHT,
) -> tuple[Material, str]:
    r"""Material of a validated ``itu-radio-material``, ``radio-material`` or ``absorber-radio-material``.

    Sionna takes the share S^2 of the reflected power out of the mirror direction and scatters it in a pattern; see
    :mod:`sarmitsuba.scene.materials.laws.effective_roughness`. The rms height loses S^2 at normal incidence. A material
    without scattering coefficient has no stated roughness and gets ``rms_height`` (m).

    Notes
    -----
    Ignores the slab's thickness (surfaces are half spaces), and that the mirror direction loses S^2 at every angle.
    """
    if plugin == "absorber-radio-material":
        return Material(name, permittivity=1.0 + 0.0j), ""
    note = ""
    if plugin == "itu-radio-material":
        dispersion = Dispersion(string_value(values, "type"))
        entry = MATERIALS[dispersion.kind]
        eps, note = entry.permittivity(frequency), entry.note(frequency)
    else:
        real, conductivity = (float_value(values, key) for key in ("relative_permittivity", "conductivity"))
        dispersion = Dispersion(real=real, conductivity=conductivity)
        eps = dispersion.permittivity(frequency)
    if "scattering_coefficient" in given or rms_height == 0.0:
        surface = scattering_surface(values, frequency)
        if float_value(values, "xpd_coefficient") > _MOST_CROSS:
            note = (
                note or f"xpd_coefficient above {_MOST_CROSS:g} is read as that: HV is never above HH and VV"
            )
    else:
        surface = rough(rms_height)
    return _material(name, eps, replace(surface, dispersion=dispersion)), note


def scattering_surface(values: Mapping[str, Value | None], frequency: float) -> Material:
    """Roughness and diffuse law of Sionna's scattering and cross-polarisation coefficients and its pattern."""
    share = min(float_value(values, "scattering_coefficient") ** 2, 0.999)
    if share == 0.0:
        return smooth()
    k = 2.0 * math.pi * frequency / SPEED_OF_LIGHT
    cross = min(float_value(values, "xpd_coefficient"), _MOST_CROSS)
    pattern, exponent = string_value(values, "scattering_pattern"), float_value(values, "alpha_r")
    parameters: dict[str, float] = {}
    if pattern == "directive":
        parameters = {"lobe_exponent": exponent}
    elif pattern == "backscattering":
        parameters = {
            "lobe_exponent": exponent,
            "back_lobe_exponent": float_value(values, "alpha_i"),
            "forward_share": float_value(values, "lambda_"),
        }
    return replace(
        smooth(),
        # exp(-4 (k s)^2) = 1 - S^2
        rms_height=math.sqrt(-math.log1p(-share) / 4.0) / k,
        diffuse_law="directive_roughness" if pattern == "directive" else "effective_roughness",
        diffuse_level_db=db_from_power(share * (1.0 - cross)),
        cross_polar_ratio_db=db_from_power(cross / (1.0 - cross)) if cross > 0.0 else -np.inf,
        law_parameters=tuple(parameters.items()),
    )


def sionna_itu_name(identifier: str) -> str:
    """ITU material of an id such as ``mat-itu_concrete`` (Sionna RT's rule), else an empty string."""
    name = identifier[4:] if identifier.startswith("mat-") else identifier
    if not name.startswith(("itu_", "itu-")):
        return ""
    return name[4:] if name[4:] in ITU_BANDS else ""


def rough_note(plugin: str, rms_height: float) -> str:
    """Note about the roughness assumed for Sionna's materials without scattering coefficient; not 0."""
    return (
        f'BSDF "{plugin}" has no scattering_coefficient and is given an rms height of {1e3 * rms_height:g} mm, '
        f"correlation length {1e3 * ORDINARY_CORRELATION * rms_height:g} mm (diffuse_law small_slope); "
        f"set default_rms_height of sar_path to change it (0 = smooth)"
    )


# Radar meaning of Mitsuba's BSDFs: plugin: (itu name or pec, named material of its typical surface or "" for a smooth
# one, words for warning and documentation)
ORDINARY_BSDFS: dict[str, tuple[str, str, str]] = {
    "diffuse": ("concrete", "concrete", "concrete"),
    "conductor": ("pec", "", "smooth perfect conductor"),
    "roughconductor": ("pec", "metal", "perfect conductor as rough as metal"),
    "dielectric": ("glass", "", "smooth glass, as a half space"),
    "thindielectric": ("glass", "", "smooth glass, as a half space"),
    "roughdielectric": ("glass", "glass", "glass as a half space"),
    "plastic": ("plastic", "plastic", "plastic of permittivity 2.25"),
    "roughplastic": ("plastic", "plastic", "plastic of permittivity 2.25"),
    "pplastic": ("plastic", "plastic", "plastic of permittivity 2.25"),
    "principled": (
        "principled",
        "",
        "perfect conductor as rough as metal if metallic > 0.5, glass if spec_trans > 0.5, else concrete",
    ),
    "principledthin": ("principled", "", "glass where spec_trans > 0.5, else concrete"),
    "measured": ("concrete", "concrete", "concrete"),
    "measured_polarized": ("concrete", "concrete", "concrete"),
    "hair": ("vacuum", "", "invisible"),
    "null": ("vacuum", "", "invisible"),
    "retarder": ("vacuum", "", "invisible"),
    "circular": ("vacuum", "", "invisible"),
    "polarizer": ("vacuum", "", "invisible"),
}

# BSDFs around another one: plugin: words
ADAPTER_BSDFS: dict[str, str] = {
    "twosided": "its nested BSDF; every surface is two-sided for a radar",
    "bumpmap": "its nested BSDF; the relief is ignored",
    "normalmap": "its nested BSDF; the relief is ignored",
    "mask": "its nested BSDF, invisible if opacity is a number below 0.5; an opacity texture is ignored",
    "blendbsdf": "its first nested BSDF where the weight is below 0.5 or a texture, else the second",
}


# kinds that a name may make of a conductor
_METALS = frozenset({"car_paint", "metal", "metal_sheet", "pec"})


def ordinary_material(
    name: str,
    plugin: str,
    values: Mapping[str, object],
    frequency: float,
    rms_height: float = ORDINARY_RMS_HEIGHT,
    called: str = "",
) -> tuple[Material, str, str]:
    """Material assumed for one of Mitsuba's own BSDFs, and the warning or the note about it.

    It is that of its id where that names one, else that of its kind, with the typical surface of either. What an
    optical conductor is called changes it to another metal only; invisible kinds stay invisible.

    Parameters
    ----------
    name : unique in the scene
    plugin : BSDF plugin; an unknown one is read as concrete
    values : its properties (only ``metallic`` and ``spec_trans`` of ``principled`` matter)
    frequency : Hz
    rms_height : m, ``default_rms_height`` of the scene; 0 makes every material smooth
    called : named material of which its id speaks; empty: of none

    Returns
    -------
    material, warning, note; one of the texts is empty

    Notes
    -----
    Colours and optical roughness are ignored: they are unrelated to radar wavelengths.
    """
    kind, surface_of, words = ORDINARY_BSDFS.get(plugin, ("concrete", "concrete", "concrete"))
    if kind == "principled":
        kind, surface_of = (
            ("pec", "metal")
            if _above_half(values, "metallic")
            else ("glass", "glass")
            if _above_half(values, "spec_trans")
            else ("concrete", "concrete")
        )
    if called and kind != "vacuum" and (kind != "pec" or called in _METALS):
        surface = typical_surface(called, frequency, rms_height)
        text = f'BSDF "{plugin}" is read as {called} by its id, {surface_words(surface)}'
        return named_material(name, called, frequency, surface)[0], "", text
    surface = typical_surface(surface_of, frequency, rms_height) if surface_of else smooth()
    if surface.scatters:
        words += f" ({surface_words(surface)})"
    warning = f'BSDF "{plugin}" has no radar parameters and is read as: {words}; '
    warning += "give it an id that names a material, or use radar_material, for another"
    if plugin not in ORDINARY_BSDFS:
        warning += ", or load the extension that defines it (--extension FILE)"
        warning += did_you_mean(plugin, ("radar_material", *ORDINARY_BSDFS, *ADAPTER_BSDFS))
    return named_material(name, kind, frequency, surface)[0], warning, ""


def adapter_note(plugin: str) -> str:
    """Warning about a BSDF that wraps another one."""
    return f'BSDF "{plugin}" is read as {ADAPTER_BSDFS[plugin]}'


def _above_half(values: Mapping[str, object], key: str) -> bool:
    value = values.get(key, 0.0)
    return isinstance(value, int | float) and value > 0.5


def _material(name: str, eps: complex, surface: Material) -> Material:
    """Surface of a permittivity; vacuum without a diffuse return is invisible."""
    reflects = LAWS[surface.diffuse_law].blocks_as_vacuum or surface.sheet_resistance > 0.0
    invisible = eps == 1.0 and not reflects
    return replace(surface, name=name, permittivity=eps, invisible=invisible)


def _check_texture(values: Mapping[str, Value | None], law: DiffuseLaw, where: str) -> None:
    """Raise where a texture is incomplete, or its surface has no diffuse return."""
    shape = float_value(values, "texture_shape")
    check_texture(shape, float_value(values, "texture_length"), where)
    if shape and not law.scatters:
        raise SceneError(f"{where}: texture_shape has no effect without a diffuse return; give a diffuse_law")


def _check_law(
    law: DiffuseLaw, values: Mapping[str, Value | None], given: frozenset[str], where: str
) -> None:
    """Raise where a parameter of the law is missing, or a parameter of another law is given."""
    if any(float_value(values, name) <= 0.0 for name in law.needs):
        needed, got = (
            " and ".join(words) for words in (law.needs, [f"{float_value(values, n):g} m" for n in law.needs])
        )
        raise SceneError(
            f"{where}: diffuse_law = {law.name} needs {needed} above 0 m, got {got}; "
            f"give {'both' if len(law.needs) == 2 else 'it' if len(law.needs) == 1 else 'all'} or take another law"
        )
    if "diffuse_level_db" in given and not law.level:
        takers = ", ".join(sorted(entry.name for entry in LAWS if entry.level))
        raise SceneError(
            f"{where}: diffuse_level_db = {float_value(values, 'diffuse_level_db'):g} dB has no effect with "
            f"diffuse_law = {law.name}; take one of {takers} or leave it out"
        )
    own = {p.name for p in law.parameters}
    for parameter in law_parameters():
        if parameter.name in given and parameter.name not in own:
            takers = ", ".join(entry.name for entry in LAWS if parameter in entry.parameters)
            raise SceneError(
                f"{where}: {parameter.name} has no effect with diffuse_law = {law.name}; "
                f"take {takers} or leave it out"
            )
    if "temporal_coherence" in given and not law.scatters:
        raise SceneError(
            f"{where}: temporal_coherence has no effect with diffuse_law = {law.name}, which has no diffuse return; "
            "use another law or leave it out"
        )


def _check_slab(surface: Material, kind: str, where: str) -> None:
    """Raise where parameters of a slab are given to another material."""
    if surface.thickness > 0.0 and kind and MATERIALS[kind].pec:
        raise SceneError(
            f"{where}: thickness = {surface.thickness:g} m has no effect with material = {kind}, which is opaque; "
            "leave it out"
        )
    slab = surface.thickness or (kind and MATERIALS[kind].thickness)
    if surface.facet_depth > 0.0 and not slab:
        raise SceneError(
            f"{where}: facet_depth = {surface.facet_depth:g} has no effect without a slab; give its thickness in m, "
            "above 0"
        )
    if surface.sheet_resistance > 0.0 and not slab:
        raise SceneError(
            f"{where}: sheet_resistance = {surface.sheet_resistance:g} ohm needs a slab; give its thickness in m, "
            "above 0"
        )


def refuse_two_permittivities(given: frozenset[str], where: str) -> None:
    """Raise a SceneError where a permittivity is given in no way, or in two."""
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
