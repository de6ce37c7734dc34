"""Absolute level and cross polarisation of diffuse ground through the kernel."""

from dataclasses import replace

import numpy as np

from sarmitsuba.core.units import db_from_power
from sarmitsuba.scene.materials.material import Material
from sarmitsuba.truth.validation.cases import CASES, CaseEntry
from sarmitsuba.truth.validation.comparison import Case, Comparison
from sarmitsuba.truth.validation.patch import COUNT_DB, LOOKS, SIZE, diffuse_flags, mean_power, standard_error


def diffuse_level(quick: bool = False) -> Case:
    """Absolute sigma0 of Lambert ground over angle."""
    theta = np.radians([20.0, 50.0] if quick else [10.0, 30.0, 50.0, 70.0])
    seeds = 4 if quick else 16
    material = Material("ground", pec=True, diffuse_law="lambert", diffuse_level_db=-10.0)
    power = np.array([mean_power(material, float(t), seeds=seeds) for t in theta])
    closed = db_from_power(0.1 * np.cos(theta) ** 2)
    sigma = 10.0 / np.log(10.0) * standard_error(seeds)
    comparisons = tuple(
        Comparison(
            channel,
            np.degrees(theta),
            closed,
            db_from_power(power[:, i]),
            tolerance=float(4.0 * sigma + COUNT_DB),
            reason=f"4 standard errors of the mean ({sigma:.3f} dB each) and {COUNT_DB:.2f} dB: 3 nodes more or less",
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
        note=f"{SIZE:g} m x {SIZE:g} m, 1 m cells, 4 rays per cell, {LOOKS} azimuths of each of {seeds} surfaces.",
    )


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
                flags=replace(diffuse_flags(channels), depolarisation=True),
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
            db_from_power(power[:, i] / co),
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


CASES.register(CaseEntry("diffuse_level", "rough", diffuse_level))
CASES.register(CaseEntry("cross_polarisation", "rough", cross_polarisation))
