"""Interferometry: coherence over the baseline, fringes of plane, slope and wall, phase statistics, heights of roofs."""

from functools import cache
from typing import Literal

import numpy as np

from sarmitsuba.analysis.interferometry import height_map
from sarmitsuba.core.arrays import F64
from sarmitsuba.truth import theory
from sarmitsuba.truth.validation.cases import CASES, CaseEntry
from sarmitsuba.truth.validation.comparison import Case, Comparison
from sarmitsuba.truth.validation.interferometric_pairs import (
    WAVELENGTH,
    Pair,
    RadarSetting,
    pair_of,
    phase_law,
)

TOPIC = "interferometry"
# edge of level ground, and of the image on it, resolution cells in slant range
GROUND_CELLS, IMAGE_CELLS = 110.0, 80.0


@cache
def ground_pair(seed: int, share: float, slope_deg: float = 0.0, passes: Literal[1, 2] = 2) -> Pair:
    """Rough ground that rises away from the radar, a share of two passes' critical baseline of level ground apart."""
    setting = RadarSetting.drawn(seed, cell=1.0)
    edge = GROUND_CELLS * setting.cell
    tan = float(np.tan(np.radians(slope_deg)))
    # to both sides of the middle far enough that foreshortening leaves the image filled
    ground = setting.parallelogram(
        (-edge, -0.6 * edge, -edge * tan), (2.0 * edge, 0.0, 2.0 * edge * tan), (0.0, 1.2 * edge, 0.0)
    )
    critical = theory.critical_baseline(WAVELENGTH, setting.slant_range, setting.incidence, setting.cell)
    return pair_of(setting, [ground], IMAGE_CELLS * setting.cell, baseline=share * critical, passes=passes)


def baseline_coherence(quick: bool = False) -> Case:
    """Coherence of rough level ground over the baseline at drawn headings and look angles."""
    shares = np.array([0.1, 0.3, 0.6] if quick else [0.05, 0.1, 0.2, 0.3, 0.45, 0.6, 0.8, 1.1])
    comparisons = []
    for seed in range(1 if quick else 4):
        got, error = [], []
        for share in shares:
            pair = ground_pair(seed, float(share))
            whole = pair.interferogram(pair.images[0].grid.shape)
            got.append(float(whole.coherence[0, 0]))
            gamma = max(1.0 - share, 0.0)
            # the standard error of n independent samples, and what none at all leaves
            error.append((1.0 - gamma**2) / np.sqrt(2.0 * whole.independent_looks))
        setting = ground_pair(seed, float(shares[0])).setting
        comparisons.append(
            Comparison(
                f"heading {setting.heading:.0f} deg {setting.side}, look {setting.look:.0f} deg, "
                f"{setting.slant_range / 1e3:.0f} km",
                shares,
                theory.baseline_coherence(shares),
                np.asarray(got),
                tolerance=float(3.0 * np.max(error) + 0.015),
                reason="3 standard errors; 0.015 for flat spectra and small angles in the closed form",
                unit="",
                shown=1,
            )
        )
    return Case(
        name="baseline_coherence",
        topic=TOPIC,
        title="Coherence of rough ground falls with the baseline",
        formula="1 - B / B_crit, B_crit = lambda R tan(theta) / (2 cell)",
        source="Zebker and Villasenor, IEEE TGRS 30 (1992); Gatelli et al., IEEE TGRS 32 (1994)",
        x_label="perpendicular baseline / critical baseline",
        y_label="coherence",
        comparisons=tuple(comparisons),
        note="Two simulated passes with automatic settings; the scatterers are the scene's, none is shared on purpose.",
    )


def interferometric_phase(quick: bool = False) -> Case:
    """Distribution of the multi-look phase of level ground under receiver noise."""
    comparisons = []
    ratios = (0.2, 1.0) if quick else (0.05, 0.2, 0.5, 1.0, 3.0)
    share = 0.02
    want, got, error = [], [], []
    for seed in range(1 if quick else 3):
        for ratio in ratios:
            pair = ground_pair(seed, share).with_noise(ratio)
            gamma = (1.0 - share) / (1.0 + ratio)
            both, whole = pair.interferogram((6, 6)), pair.interferogram(pair.images[0].grid.shape)
            want.append(gamma)
            got.append(float(whole.coherence[0, 0]))
            error.append((1.0 - gamma**2) / np.sqrt(2.0 * whole.independent_looks))
            if seed > 0 and ratio not in (0.2, 1.0):
                continue
            away = np.angle(both.values * np.exp(-1j * np.angle(both.values.sum())))
            label = f"noise / signal {ratio:g}, {both.independent_looks:.1f} looks, {away.size} blocks, seed {seed}"
            comparisons.append(phase_law(label, away, gamma, both.independent_looks))
    comparisons.append(
        Comparison(
            "coherence against (1 - B / B_crit) / (1 + noise / signal)",
            np.asarray(ratios * (len(want) // len(ratios))),
            np.asarray(want),
            np.asarray(got),
            tolerance=float(3.0 * np.max(error) + 0.01),
            reason="3 standard errors; 0.01 for the noise of the image's mean, from which the ratio is taken",
            unit="",
        )
    )
    return Case(
        name="interferometric_phase",
        topic=TOPIC,
        title="Phase noise of given coherence and looks",
        formula="density of the phase of n looks (2F1)",
        source="Lee et al., IEEE TGRS 32 (1994), eq. 20; Zebker and Villasenor, IEEE TGRS 30 (1992)",
        x_label="phase less its mean (rad), or noise / signal",
        y_label="probability, or coherence",
        comparisons=tuple(comparisons),
        note="Blocks of 6 x 6 pixels of half a cell; coherence and looks are predicted, not fitted. Baselines "
        "decorrelate otherwise: what is left in common is a part of the band, and the phase scatters less than this.",
    )


def fringes(quick: bool = False) -> Case:
    """Flat-earth phase of level ground, and the ramp that a slope adds."""
    comparisons = []
    for seed in range(1, 2 if quick else 5):
        pair = ground_pair(seed, 0.05)
        both = pair.interferogram((8, 8))
        first, second = (radar.track.center_position for radar in pair.radars)
        points = both.positions()
        want = theory.flat_earth_phase(first, second, points, both.wavelength)
        got = want + np.angle(both.with_flat_earth() * np.exp(-1j * want))
        column = np.argsort(points.mean(axis=0) @ pair.setting.axes[0])
        x = points.mean(axis=0)[column] @ pair.setting.axes[0]
        middle = want[:, column].mean(axis=0)
        looks = both.independent_looks * both.grid.shape[0]
        comparisons.append(
            Comparison(
                f"flat earth, seed {seed}, {abs(np.ptp(middle)) / (2 * np.pi):.0f} fringes",
                x,
                middle - middle[0],
                got[:, column].mean(axis=0) - middle[0],
                tolerance=float(5.0 * np.sqrt((1.0 - 0.95**2) / (2.0 * looks * 0.95**2))),
                reason="5 standard deviations of the phase of a column's looks at coherence 0.95",
                unit="rad",
                shown=x.size - 1,
            )
        )
    comparisons.append(
        _slopes(np.array([-10.0, 8.0] if quick else [-20.0, -10.0, -5.0, 5.0, 10.0, 15.0]), passes=2)
    )
    comparisons.append(_slopes(np.array([8.0] if quick else [-20.0, -10.0, 10.0, 15.0]), passes=1))
    return Case(
        name="fringes",
        topic=TOPIC,
        title="Fringes of level and of sloped ground",
        formula="-4 pi (R1 - R2) / lambda; k_z tan a / (1 - tan a / tan t), k_z = -4 pi B / (lambda R sin t)",
        source="Bamler and Hartl, Inverse Problems 14 (1998)",
        x_label="ground range (m), or slope (deg)",
        y_label="phase (rad), or its ramp (rad/m)",
        comparisons=tuple(comparisons),
        note="A twentieth of the critical baseline; drawn headings.",
    )


def _slopes(slopes: F64, passes: Literal[1, 2]) -> Comparison:
    """Ramps of slopes seen from two passes, or from two receivers, which see half of them."""
    want, got = [], []
    for slope in slopes:
        pair = ground_pair(1, 0.05, float(slope), passes)
        s = pair.setting
        ramp = theory.slope_phase_ramp(
            WAVELENGTH, s.slant_range, s.incidence, pair.perpendicular, float(np.radians(slope))
        )
        want.append(0.5 * passes * ramp)
        got.append(_ramp(pair))
    return Comparison(
        f"ramp of a slope, flat earth removed, {'two passes' if passes == 2 else 'one pass, two receivers'}",
        slopes,
        np.asarray(want),
        np.asarray(got),
        tolerance=float(0.01 * np.abs(want).max()),
        reason="1 % of the steepest: plane waves in the closed form, and noise of the fit",
        unit="rad/m",
    )


def _ramp(pair: Pair) -> float:
    """Mean change of phase per metre away from the radar on the image plane, rad/m."""
    both = pair.interferogram((8, 4))
    step = np.angle(np.sum(both.values[:, 1:] * both.values[:, :-1].conj()))
    x = pair.setting.local(both.positions())[..., 0]
    ramp = step / float(np.mean(np.diff(x, axis=1)))
    # the mean step is a first guess whose fringe is removed; what is left is fitted
    rest = (both.values * np.exp(-1j * ramp * x)).sum(axis=0)
    fit = np.polyfit(x.mean(axis=0), np.unwrap(np.angle(rest)), 1, w=np.abs(rest))
    return float(ramp + fit[0])


def wall_phase(quick: bool = False) -> Case:
    """Phase ramp over a wall that is laid over towards the radar."""
    comparisons = []
    height, width = 24.0, 40.0
    for seed in range(1 if quick else 4):
        setting = RadarSetting.drawn(seed + 20, cell=0.5)
        wall = setting.parallelogram((0.0, -width / 2, 0.0), (0.0, width, 0.0), (0.0, 0.0, height))
        pair = pair_of(setting, [wall], 90.0, relief=height)
        both = pair.interferogram((8, 2))
        local = setting.local(both.positions())
        # slant range of the plane's places less that of the wall's foot: of exact spheres, not of plane waves
        origin = pair.radars[0].track.center_position
        ranges = np.linalg.norm(both.positions() - origin, axis=-1) - setting.slant_range
        deep = height * np.cos(setting.incidence)
        on = (np.abs(local[..., 1]) < 0.4 * width) & (ranges > -0.9 * deep) & (ranges < -0.1 * deep)
        ramp = theory.wall_phase_ramp(WAVELENGTH, setting.slant_range, setting.incidence, pair.perpendicular)
        axis = np.linspace(-0.85, -0.15, 8) * deep
        got = []
        for place in axis:
            near = on & (np.abs(ranges - place) < 0.05 * deep)
            total = np.sum(both.values[near] * np.exp(-1j * ramp * ranges[near]))
            got.append(ramp * place + float(np.angle(total)))
        comparisons.append(
            Comparison(
                f"heading {setting.heading:.0f} deg {setting.side}, look {setting.look:.0f} deg",
                axis,
                ramp * axis,
                np.asarray(got),
                tolerance=0.05,
                reason="plane waves in the closed form; noise of some hundred looks",
                unit="rad",
                shown=0,
            )
        )
    return Case(
        name="wall_phase",
        topic=TOPIC,
        title="Layover: phase ramp over a wall",
        formula="4 pi B / (lambda R sin t cos t) per metre of slant range",
        source="Bamler and Hartl, Inverse Problems 14 (1998); place z up a wall is z cos t nearer",
        x_label="slant range less that of the wall's foot (m)",
        y_label="phase (rad), flat earth removed",
        comparisons=tuple(comparisons),
        note=f"A rough wall of {height:g} m facing the radar, nothing else; automatic baseline.",
    )


def roof_height(quick: bool = False) -> Case:
    """Heights of roofs recovered from two passes."""
    want, got, spread = [], [], []
    for seed in range(2 if quick else 8):
        setting = RadarSetting.drawn(seed + 40, cell=0.75)
        height = float(np.random.default_rng([seed, 8]).uniform(4.0, 15.0))
        want.append(height)
        z, sigma = recovered_roof(setting, height)
        got.append(z)
        spread.append(sigma)
    number = np.arange(len(want), dtype=np.float64)
    return Case(
        name="roof_height",
        topic=TOPIC,
        title="Height of a roof from two passes",
        formula="the height itself",
        source="place of given range, Doppler and phase: Madsen, Zebker and Martin, IEEE TGRS 31 (1993)",
        x_label="building",
        y_label="height (m)",
        comparisons=(
            Comparison(
                "roofs of drawn heights, headings and look angles",
                number,
                np.asarray(want),
                np.asarray(got),
                tolerance=0.15,
                reason="phase noise of some hundred looks; side lobes of the bright line at the foot, -35 dB",
                unit="m",
                shown=0,
            ),
        ),
        note="Median over the roof where neither wall nor ground is laid over it; automatic settings and baseline; "
        f"standard deviation of one block {np.min(spread):.2f} to {np.max(spread):.2f} m.",
    )


def recovered_roof(setting: RadarSetting, height: float) -> tuple[float, float]:
    """Median height over the free part of a roof, and the standard deviation over its blocks, m."""
    shift = height / float(np.tan(setting.incidence))
    depth, width = shift + 20.0, 28.0
    edge = depth + shift + 24.0
    p = setting.parallelogram
    x0, y0 = -depth / 2, -width / 2
    meshes = [
        p((x0, y0, height), (depth, 0, 0), (0, width, 0)),
        p((x0, y0, 0), (0, width, 0), (0, 0, height)),
        p((x0, y0, 0), (0, 0, height), (depth, 0, 0)),
        p((x0, -y0, 0), (depth, 0, 0), (0, 0, height)),
        p((-edge, -edge, 0), (2 * edge, 0, 0), (0, 2 * edge, 0)),
    ]
    pair = pair_of(setting, meshes, edge, relief=height, window="taylor")
    both = pair.interferogram()
    local = setting.local(both.positions())
    # half a block, and two cells from the bright line at the foot
    margin = 0.5 * max(both.grid.azimuth_spacing, both.grid.range_spacing) + 2.0
    free = (local[..., 0] > x0 + margin) & (local[..., 0] < x0 + depth - shift - margin)
    free &= np.abs(local[..., 1]) < width / 2 - margin
    z = height_map(both).z[free]
    return float(np.median(z)), float(z.std())


CASES.register(CaseEntry("baseline_coherence", TOPIC, baseline_coherence))
CASES.register(CaseEntry("interferometric_phase", TOPIC, interferometric_phase))
CASES.register(CaseEntry("fringes", TOPIC, fringes))
CASES.register(CaseEntry("wall_phase", TOPIC, wall_phase))
CASES.register(CaseEntry("roof_height", TOPIC, roof_height))
