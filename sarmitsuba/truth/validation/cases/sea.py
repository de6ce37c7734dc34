"""The sea under wind: slopes of the spectrum, level through the kernel, against scatterometers, and permittivity."""

from dataclasses import replace

import numpy as np

from sarmitsuba.core.arrays import F64
from sarmitsuba.core.constants import SPEED_OF_LIGHT
from sarmitsuba.core.units import db_from_power
from sarmitsuba.scene.materials.laws.sea import TILTING, two_scale_sigma0
from sarmitsuba.scene.materials.material import Material
from sarmitsuba.scene.materials.named.water import klein_swift
from sarmitsuba.scene.materials.sea_spectrum import SeaState
from sarmitsuba.truth.theory import sea as theory
from sarmitsuba.truth.validation.band_sampling import X_BAND, X_WAVELENGTH
from sarmitsuba.truth.validation.cases import CASES, CaseEntry
from sarmitsuba.truth.validation.comparison import Case, Comparison
from sarmitsuba.truth.validation.patch import COUNT_DB, LOOKS, diffuse_flags, mean_power, standard_error

C_BAND, KU_BAND = 5.3e9, 13.6e9
# what altimeters see straight down under the world's mean wind of 7 m/s (Witter and Chelton, J. Geophys. Res. 96, 1991)
ALTIMETER_DB = 11.1
# longer than any wave: the whole sea is in the law
ALL_IN_LAW = 1e4
# rad/m, below every wave of a sea under 20 m/s
LONGEST = 2.0 * np.pi / ALL_IN_LAW
SPECTRUM = "Elfouhaily et al., J. Geophys. Res. 102 (C7) 1997"


def water(wind: float, bearing_deg: float, permittivity: complex, name: str = "sea") -> Material:
    """A fully developed sea, all of whose waves are in the law."""
    parameters = {"wind_speed": wind, "wind_direction_deg": bearing_deg, "shortest_drawn_wave": ALL_IN_LAW}
    return Material(
        name, permittivity=permittivity, diffuse_law="sea", law_parameters=tuple(parameters.items())
    )


def slopes(quick: bool = False) -> Case:
    """Slope variances of the spectrum against Cox and Munk's, and moments against another integration."""
    wind = np.array([5.0, 10.0, 15.0])
    seas = [SeaState(float(u)).moments() for u in wind]
    measured_u, measured_c = theory.cox_munk(wind)
    low = [0.1 * SeaState(float(u)).peak for u in wind]
    exact = np.array([theory.band_integral(float(u), a, 7400.0, 2.0) for u, a in zip(wind, low, strict=True)])
    orbit = np.array(
        [theory.band_integral(float(u), a, 7400.0, 2.0, 2.0) for u, a in zip(wind, low, strict=True)]
    )

    def compare(label: str, want: F64, got: list[float], tolerance: float, reason: str) -> Comparison:
        return Comparison(label, wind, want, np.array(got), tolerance, reason, unit="dB", shown=1)

    integral = "the published formula, integrated anew: quadrature"
    against = "measured to +- 0.004 (0.6 dB at 5 m/s, 0.2 dB at 15 m/s); the spectrum was fitted to these and others"
    return Case(
        name="sea_slopes",
        topic="rough",
        title="Slopes and orbital velocities of wind waves",
        formula="variance = integral of k^2 S (1/2 +- Delta/4) dk; Cox and Munk: 3.16e-3 U, 0.003 + 1.92e-3 U",
        source=f"{SPECTRUM}; Cox and Munk, J. Opt. Soc. Am. 44 (1954)",
        x_label="wind speed (m/s)",
        y_label="variance (dB)",
        comparisons=(
            compare(
                "slope along the wind, Cox and Munk",
                db_from_power(measured_u),
                [float(db_from_power(m.slope_u)) for m in seas],
                1.0,
                against,
            ),
            compare(
                "slope across the wind, Cox and Munk",
                db_from_power(measured_c),
                [float(db_from_power(m.slope_c)) for m in seas],
                1.0,
                against,
            ),
            compare(
                "slope, along, spectrum",
                db_from_power(exact[:, 0]),
                [float(db_from_power(m.slope_u)) for m in seas],
                0.01,
                integral,
            ),
            compare(
                "orbital velocity, across, spectrum",
                db_from_power(orbit[:, 1]),
                [float(db_from_power(m.speed_c)) for m in seas],
                0.01,
                integral,
            ),
        ),
        note="Fully developed seas.",
    )


def level(quick: bool = False) -> Case:
    """Sigma0 of a patch of sea through the kernel at drawn winds and looks, against another integration."""
    rng = np.random.default_rng(17)
    count, seeds = (3, 2) if quick else (8, 8)
    theta = np.sort(rng.uniform(np.radians(22.0), np.radians(58.0), count))
    wind, bearing = rng.uniform(4.0, 15.0, count), rng.uniform(0.0, 360.0, count)
    look = rng.uniform(0.0, 2.0 * np.pi, count)
    permittivity = klein_swift(X_BAND, 15.0, 35.0)
    half = np.radians(3.0)
    got, want = np.zeros((count, 2)), np.zeros((count, 2))
    for i in range(count):
        material = water(float(wind[i]), float(bearing[i]), permittivity)
        got[i] = mean_power(
            material,
            float(theta[i]),
            seeds=seeds,
            sector=(look[i] - half, look[i] + half),
            flags=replace(diffuse_flags(("HH", "VV")), polarised_diffuse=True),
        )
        # compass bearings turn the other way round, from north
        azimuth = float(look[i]) - (0.5 * np.pi - np.radians(bearing[i]))
        want[i] = theory.two_scale(
            float(wind[i]),
            X_WAVELENGTH,
            permittivity,
            float(theta[i]),
            azimuth,
            longest=LONGEST,
            split=TILTING * 2.0 * np.pi / X_WAVELENGTH,
        )
    sigma = 10.0 / np.log(10.0) * standard_error(seeds)
    comparisons = tuple(
        Comparison(
            channel,
            np.degrees(theta),
            db_from_power(want[:, c]),
            db_from_power(got[:, c]),
            tolerance=float(4.0 * sigma + COUNT_DB + 0.1),
            reason=f"4 standard errors ({sigma:.2f} dB each), {COUNT_DB:.2f} dB for 3 nodes, 0.1 dB for the tables",
            unit="dB",
            shown=0,
        )
        for c, channel in enumerate(("HH", "VV"))
    )
    return Case(
        name="sea_level",
        topic="rough",
        title="Two-scale sigma0 of the sea through the kernel",
        formula="Bragg scattering by short waves, tilted by the slopes of the longer ones, and mirroring facets",
        source="Valenzuela, Boundary-Layer Meteorol. 13 (1978)",
        x_label="incidence angle (deg)",
        y_label="sigma0 (dB)",
        comparisons=comparisons,
        note=f"X band, drawn winds (4 to 15 m/s, any direction) and looks; {LOOKS} looks within 6 deg at each "
        f"of {seeds} surfaces. The closed form sums facets as vectors, in code of its own.",
    )


def scatterometer(quick: bool = False) -> Case:
    """C-band level against CMOD5.N and the polarisation ratio of Thompson et al., upwind and crosswind."""
    theta = np.radians(np.arange(20.0, 56.0, 5.0))
    permittivity, k = klein_swift(C_BAND, 15.0, 35.0), 2.0 * np.pi * C_BAND / SPEED_OF_LIGHT
    comparisons = []
    for wind in (5.0, 10.0, 15.0):
        for name, azimuth in (("upwind and downwind", 0.0), ("crosswind", 0.5 * np.pi)):
            both = [theory.cmod5n(wind, a, theta) for a in (azimuth, np.pi - azimuth)]
            _, vv = two_scale_sigma0(SeaState(wind), k, permittivity, LONGEST, theta, azimuth)
            comparisons.append(
                Comparison(
                    f"VV, {wind:g} m/s, {name}",
                    np.degrees(theta),
                    db_from_power(np.sqrt(both[0] * both[1])),
                    db_from_power(vv),
                    tolerance=2.0 if azimuth == 0.0 else 5.0,
                    reason="two models of the sea: 2 dB is usual for a two-scale one"
                    + (
                        ""
                        if azimuth == 0.0
                        else "; the spectrum spreads too little near 20 deg, too much at 55 deg"
                    ),
                    unit="dB",
                    shown=4,
                )
            )
    steep = theta[theta < np.radians(46.0)]
    hh, vv = two_scale_sigma0(SeaState(10.0), k, permittivity, LONGEST, steep, 0.0)
    comparisons.append(
        Comparison(
            "VV over HH, 10 m/s, upwind",
            np.degrees(steep),
            db_from_power(theory.polarisation_ratio(steep)),
            db_from_power(vv / hh),
            tolerance=1.5,
            reason="the fit knows breaking waves, whose HH equals VV, and two-scale theory none; 3 dB at 55 deg",
            unit="dB",
            shown=4,
        )
    )
    ku, wavenumber = klein_swift(KU_BAND, 15.0, 35.0), 2.0 * np.pi * KU_BAND / SPEED_OF_LIGHT
    comparisons.append(
        Comparison(
            "Ku band, 7 m/s, straight down, altimeters",
            np.zeros(1),
            np.array([ALTIMETER_DB]),
            db_from_power(two_scale_sigma0(SeaState(7.0), wavenumber, ku, LONGEST, np.zeros(1), 0.0)[1]),
            tolerance=3.0,
            reason="short waves spread the mirrored lobe by more than the loss exp(-4 k^2 s^2) that is taken here",
            unit="dB",
            shown=0,
        )
    )
    return Case(
        name="sea_scatterometer",
        topic="rough",
        title="The sea against satellite scatterometers and altimeters",
        formula="CMOD5.N, mean of upwind and downwind in dB; VV/HH = ((1 + 2 tan^2 t) / (1 + 0.6 tan^2 t))^2",
        source="Hersbach, ECMWF Technical Memorandum 554 (2008); Thompson et al., IGARSS 1998; "
        "Witter and Chelton, J. Geophys. Res. 96 (1991)",
        x_label="incidence angle (deg)",
        y_label="sigma0, ratio (dB)",
        comparisons=tuple(comparisons),
        note="5.3 GHz, 15 C, 35 g/kg. The model has no free parameter; nothing was fitted to these.",
    )


def permittivity(quick: bool = False) -> Case:
    """Permittivity of water against another fit of the same kind of measurements."""
    frequency = np.array([1.27, 3.2, 5.4, 9.65, 13.4]) * 1e9
    comparisons = []
    for temperature, salinity in ((5.0, 35.0), (20.0, 35.0), (20.0, 0.0)):
        own = np.array([klein_swift(float(f), temperature, salinity) for f in frequency])
        other = np.array([theory.sea_water_permittivity(float(f), temperature, salinity) for f in frequency])
        comparisons.append(
            Comparison(
                f"{temperature:g} C, {salinity:g} g/kg",
                frequency / 1e9,
                db_from_power(np.abs(other)),
                db_from_power(np.abs(own)),
                tolerance=0.25,
                reason="two fits: 5 % apart for salt water, the same for fresh",
                unit="dB",
                shown=3,
            )
        )
    return Case(
        name="water_permittivity",
        topic="materials",
        title="Permittivity of fresh and salt water",
        formula="Debye relaxation with conductivity",
        source="Stogryn, IEEE Trans. MTT 19 (1971), against Klein and Swift, IEEE Trans. AP 25 (1977)",
        x_label="frequency (GHz)",
        y_label="modulus (dB)",
        comparisons=tuple(comparisons),
    )


CASES.register(CaseEntry("sea_slopes", "rough", slopes))
CASES.register(CaseEntry("sea_level", "rough", level))
CASES.register(CaseEntry("sea_scatterometer", "rough", scatterometer))
CASES.register(CaseEntry("water_permittivity", "materials", permittivity))
