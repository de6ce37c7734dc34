"""Diffuse ground through the kernel: absolute level, laws over angle, cross polarisation."""

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sarmitsuba.effects.flags import KernelFlags
from sarmitsuba.materials.fresnel import fresnel
from sarmitsuba.materials.material import Material
from sarmitsuba.simulation.rcs import monostatic_rcs
from sarmitsuba.validation import targets
from sarmitsuba.validation.comparison import Case, CaseEntry, Comparison, db

F64 = NDArray[np.float64]
FREQUENCY = targets.BANDS["X"]
LAM = targets.wavelength("X")
SOIL = 15.0 - 3.0j
# edge of a scatterer cell in the far-field tracer, m
CELL = 1.0
RAYS_PER_CELL = 4.0
# edge of the patch, m, and looks a surface: few cells and many looks cost least for a given standard error
SIZE, LOOKS = 24.0, 150
# tubes across the patch's rim lend part of their area to cells outside it: 0.14 cells' power a side, dB
RIM_DB = 10.0 * np.log10(1.0 + 4.0 * 0.14 / SIZE)


def diffuse_flags(channels: tuple[str, ...], **changes: Any) -> KernelFlags:
    """Kernel effects of a lone rough patch: diffuse scatterers and nothing else."""
    flags = KernelFlags(
        channels=channels,
        fresnel=False,
        roughness=False,
        coherent=False,
        diffuse_double=False,
        depolarisation=False,
        antenna_pattern=False,
        taper=False,
        visibility=False,
        multi_bounce=False,
    )
    return replace(flags, **changes)


def standard_error(seeds: int) -> float:
    """Relative standard error of ``mean_power``: independent looks, and independent cells of one surface each."""
    return float(np.sqrt(1.0 / (LOOKS * seeds) + 1.0 / (SIZE**2 * seeds)))


def mean_power(
    material: Material,
    theta: float,
    *,
    channels: tuple[str, ...] = ("HH", "VV"),
    size: float = SIZE,
    looks: int = LOOKS,
    seeds: int = 8,
    flags: KernelFlags | None = None,
) -> F64:
    """Mean |channel|^2 over the patch's area (sigma0, linear), one value a channel.

    Looks at one incidence angle from random azimuths are independent samples of speckle; each seed is another
    surface.
    """
    rng = np.random.default_rng(11)
    total = np.zeros(len(channels))
    spacing = CELL * np.sqrt(np.cos(theta) / RAYS_PER_CELL)
    for seed in range(seeds):
        azimuth = 2.0 * np.pi * rng.random(looks)
        result = monostatic_rcs(
            targets.plate(size, size),
            (material,),
            targets.from_azimuth(azimuth, np.pi / 2.0 - theta),
            FREQUENCY,
            channels=channels,
            ray_spacing=float(spacing),
            max_depth=1,
            flags=flags or diffuse_flags(channels),
            seed=seed,
        )
        total += np.mean(np.abs(result.amplitude[:, 0, :]) ** 2, axis=0)
    return total / seeds / size**2


def diffuse_level(quick: bool = False) -> Case:
    """Absolute sigma0 of Lambert ground over angle."""
    theta = np.radians([20.0, 50.0] if quick else [10.0, 30.0, 50.0, 70.0])
    seeds = 4 if quick else 16
    material = Material("ground", pec=True, diffuse_law="lambert", diffuse_level_db=-10.0)
    power = np.array([mean_power(material, float(t), seeds=seeds) for t in theta])
    closed = db(0.1 * np.cos(theta) ** 2)
    sigma = 10.0 / np.log(10.0) * standard_error(seeds)
    comparisons = tuple(
        Comparison(
            channel,
            np.degrees(theta),
            closed,
            db(power[:, i]),
            tolerance=float(4.0 * sigma + RIM_DB),
            reason=f"4 standard errors of the mean ({sigma:.3f} dB each) and {RIM_DB:.2f} dB of the rim",
            unit="dB",
            shown=0,
        )
        for i, channel in enumerate(("HH", "VV"))
    )
    return Case(
        name="diffuse_level",
        topic="rough",
        title="Absolute level of diffuse ground",
        formula="sigma0 = 4 A cos^2 t, 4 A = -10 dB",
        source="Lambert's law",
        x_label="incidence angle (deg)",
        y_label="sigma0 (dB)",
        comparisons=comparisons,
        note=f"{SIZE:g} m x {SIZE:g} m, 1 m cells, 4 rays a cell, {LOOKS} azimuths of each of {seeds} surfaces.",
    )


LAWS = (
    Material("constant", pec=True, diffuse_law="constant", diffuse_level_db=-12.0),
    Material("constant gamma", pec=True, diffuse_law="constant_gamma", diffuse_level_db=-12.0),
    Material(
        "kirchhoff", permittivity=SOIL, rms_height=0.02, correlation_length=0.141, diffuse_law="kirchhoff"
    ),
    Material(
        "small perturbation",
        permittivity=SOIL,
        rms_height=0.001,
        correlation_length=0.03,
        diffuse_law="small_perturbation",
    ),
    Material("iem", permittivity=SOIL, rms_height=0.004, correlation_length=0.04, diffuse_law="iem"),
    Material("roughness", permittivity=SOIL, rms_height=0.004, diffuse_law="roughness"),
)


def diffuse_laws(quick: bool = False) -> Case:
    """Every law over angle through the kernel, HH and VV, with the speckle divided out."""
    degrees = np.array([10.0, 30.0, 50.0] if quick else [2.0, 10.0, 20.0, 30.0, 40.0, 50.0, 60.0, 70.0])
    theta = np.radians(degrees)
    unit = Material("unit", pec=True, diffuse_law="constant", diffuse_level_db=0.0)
    settings = {"size": 8.0, "looks": 16, "seeds": 1}
    reference = np.array([mean_power(unit, float(t), **settings) for t in theta])  # type: ignore[arg-type]
    comparisons = []
    for material in LAWS:
        power = np.array([mean_power(material, float(t), **settings) for t in theta]) / reference  # type: ignore[arg-type]
        closed = _closed_law(material, theta)
        for i, channel in enumerate(("HH", "VV")):
            if i == 1 and np.array_equal(closed[0], closed[1]):
                continue
            comparisons.append(
                Comparison(
                    f"{material.name}, {channel}",
                    degrees,
                    db(closed[i]),
                    db(power[:, i]),
                    tolerance=0.1,
                    reason="linear interpolation in a table of 256 angles",
                    unit="dB",
                    floor=60.0,
                    shown=int(np.argmin(np.abs(degrees - 30.0))),
                )
            )
    return Case(
        name="diffuse_laws",
        topic="rough",
        title="Diffuse laws over angle through the kernel",
        formula="constant, gamma cos t, Kirchhoff, small perturbation, integral equation, shared energy",
        source="Ulaby, Moore and Fung II (1982); Fung, Li and Chen (1992); each evaluated anew at the angle",
        x_label="incidence angle (deg)",
        y_label="sigma0 (dB)",
        comparisons=tuple(comparisons),
        note="Relative to a surface of sigma0 = 1 with the same rays and scatterers, so that speckle cancels.",
    )


def _closed_law(material: Material, theta: F64) -> tuple[F64, F64]:
    """Law of a material at exact angles, without the kernel's table."""
    from sarmitsuba.materials.laws.iem import iem_backscatter
    from sarmitsuba.materials.laws.roughness import shared_energy_sigma0
    from sarmitsuba.materials.laws.small_perturbation import small_perturbation_sigma0

    k, s, length = 2.0 * np.pi / LAM, material.rms_height, material.correlation_length
    level = 10.0 ** (material.diffuse_level_db / 10.0)
    c = np.cos(theta)
    if material.diffuse_law == "constant":
        same = np.full_like(theta, level)
    elif material.diffuse_law == "constant_gamma":
        same = level * c
    elif material.diffuse_law == "kirchhoff":
        m2 = 2.0 * (s / length) ** 2
        r2 = float(np.abs((np.sqrt(SOIL) - 1.0) / (np.sqrt(SOIL) + 1.0)) ** 2)
        same = r2 * np.exp(-(np.tan(theta) ** 2) / (2.0 * m2)) / (2.0 * m2 * c**4)
    elif material.diffuse_law == "small_perturbation":
        return small_perturbation_sigma0(theta, SOIL, k, s, length)
    elif material.diffuse_law == "iem":
        return iem_backscatter(theta, SOIL, k, s, length)
    else:
        fine = np.linspace(0.0, np.pi / 2.0, 4001)
        pair = []
        for r in fresnel(np.cos(fine), SOIL):
            pair.append(np.interp(theta, fine, shared_energy_sigma0(fine, np.abs(r) ** 2, k * s)))
        return pair[0], pair[1]
    return same, same


def cross_polarisation(quick: bool = False) -> Case:
    """Ratio of cross- to co-polar diffuse power over angle."""
    theta = np.radians([20.0, 50.0] if quick else [10.0, 35.0, 60.0])
    ratio = -8.0
    material = Material(
        "ground", pec=True, diffuse_law="lambert", diffuse_level_db=0.0, cross_polar_ratio_db=ratio
    )
    channels = ("HH", "HV", "VH", "VV")
    seeds = 4 if quick else 12
    power = np.array(
        [
            mean_power(
                material,
                float(t),
                channels=channels,
                seeds=seeds,
                flags=diffuse_flags(channels, depolarisation=True),
            )
            for t in theta
        ]
    )
    sigma = 10.0 / np.log(10.0) * np.sqrt(2.0) * standard_error(seeds)
    co = 0.5 * (power[:, 0] + power[:, 3])
    comparisons = tuple(
        Comparison(
            f"{channel} over mean of HH and VV",
            np.degrees(theta),
            np.full(theta.size, ratio),
            db(power[:, i] / co),
            tolerance=float(4.0 * sigma),
            reason=f"4 standard errors of a ratio of means, {sigma:.3f} dB each",
            unit="dB",
            shown=0,
        )
        for i, channel in enumerate(channels)
        if i in (1, 2)
    )
    return Case(
        name="cross_polarisation",
        topic="rough",
        title="Cross-polar diffuse return",
        formula="<|HV|^2> / <|HH|^2> = cross_polar_ratio at every angle, HV = VH",
        source="definition of the material's parameter; azimuthally symmetric covariance",
        x_label="incidence angle (deg)",
        y_label="ratio (dB)",
        comparisons=comparisons,
        note="-8 dB asked for.",
    )


CASES = (
    CaseEntry("diffuse_level", "rough", diffuse_level),
    CaseEntry("diffuse_laws", "rough", diffuse_laws),
    CaseEntry("cross_polarisation", "rough", cross_polarisation),
)

__all__ = ["CASES", "cross_polarisation", "diffuse_flags", "diffuse_laws", "diffuse_level", "mean_power"]
