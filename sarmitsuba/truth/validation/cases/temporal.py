"""Temporal decorrelation: coherence over time with that of the baseline, its statistics, a wall over a field."""

from dataclasses import replace

import numpy as np

from sarmitsuba.analysis.interferometry import Interferogram
from sarmitsuba.core.units import power_from_db
from sarmitsuba.truth import theory
from sarmitsuba.truth.validation.cases import CASES, CaseEntry
from sarmitsuba.truth.validation.comparison import Case, Comparison
from sarmitsuba.truth.validation.interferometric_pairs import (
    ROUGH,
    WAVELENGTH,
    Pair,
    RadarSetting,
    pair_of,
    phase_law,
)

TOPIC = "interferometry"
# edges of level ground and of the image on it, resolution cells in slant range
GROUND_CELLS, IMAGE_CELLS = 90.0, 64.0
# scatterers in a resolution cell of level ground, at least: each of them changes as a whole
SCATTERERS = 2.0


def changed_pair(
    setting: RadarSetting, long_term: float, decay_days: float, days: float, share: float = 0.0
) -> Pair:
    """Both passes over level ground that changes, at a fraction of the critical baseline."""
    material = replace(ROUGH, temporal_coherence=long_term, decorrelation_days=decay_days)
    edge = GROUND_CELLS * setting.cell
    ground = setting.parallelogram((-edge, -0.6 * edge, 0.0), (2.0 * edge, 0.0, 0.0), (0.0, 1.2 * edge, 0.0))
    critical = theory.critical_baseline(WAVELENGTH, setting.slant_range, setting.incidence, setting.cell)
    extent = IMAGE_CELLS * setting.cell
    return pair_of(setting, [ground], extent, materials=(material,), baseline=share * critical, days=days)


def whole(pair: Pair) -> Interferogram:
    """Interferogram of the whole image as one block."""
    return pair.interferogram(pair.images[0].grid.shape)


def spread(gamma: float, looks: float, changes: bool) -> float:
    """Standard error of a sample coherence; where scatterers change one by one, that of the share that does too."""
    estimator = (1.0 - gamma**2) / np.sqrt(2.0 * looks)
    chance = np.sqrt(gamma * (1.0 - gamma) / (SCATTERERS * looks)) if changes else 0.0
    return float(np.hypot(estimator, chance))


def temporal_decorrelation(quick: bool = False) -> Case:
    """Coherence of ground of drawn materials, passes apart in time and in place."""
    want, got, error = [], [], []
    for seed in range(2 if quick else 12):
        rng = np.random.default_rng([seed, 1992])
        setting = RadarSetting.drawn(seed + 60, cell=1.0)
        long_term, share = float(rng.uniform(0.0, 0.9)), float(rng.uniform(0.0, 0.4))
        decay = float(rng.uniform(3.0, 30.0)) if seed % 2 else 0.0
        days = float(rng.uniform(1.0, 40.0))
        pair = whole(changed_pair(setting, long_term, decay, days, share))
        gamma = float(theory.temporal_coherence(days, long_term, decay) * theory.baseline_coherence(share))
        want.append(theory.rms_coherence(gamma, pair.independent_looks))
        got.append(float(pair.coherence[0, 0]))
        error.append(spread(gamma, pair.independent_looks, decay > 0.0))
    return Case(
        name="temporal_decorrelation",
        topic=TOPIC,
        title="Coherence of ground that changes between passes",
        formula="(g + (1 - g) exp(-t / tau)) (1 - B / B_crit)",
        source="Zebker and Villasenor, IEEE TGRS 30 (1992); Rocca, IEEE TGRS 45 (2007)",
        x_label="pair",
        y_label="coherence",
        comparisons=(
            Comparison(
                "drawn materials, days, baselines, headings, sides and look angles",
                np.arange(len(want), dtype=np.float64),
                np.asarray(want),
                np.asarray(got),
                tolerance=float(3.5 * np.max(error) + 0.015),
                reason="3.5 standard errors; 0.015 for flat spectra and small angles in the baseline's part",
                unit="",
                shown=0,
            ),
            _stack(quick),
        ),
        note="Every pass is a run of its own that knows its own time only; root mean squares of the sample coherence.",
    )


def _stack(quick: bool) -> Comparison:
    """Coherence of any two passes of a stack."""
    setting = RadarSetting.drawn(73, cell=1.0)
    days = (0.0, 4.0, 15.0) if quick else (0.0, 2.0, 5.0, 11.0, 23.0, 60.0)
    long_term, decay = 0.25, 9.0
    pairs = [changed_pair(setting, long_term, decay, t) for t in days[1:]]
    images = [pairs[0].images[0], *(pair.images[1] for pair in pairs)]
    apart, got, error = [], [], []
    for i, one in enumerate(images):
        for j in range(i):
            pair = whole(replace(pairs[0], images=(images[j], one)))
            apart.append(days[i] - days[j])
            got.append(float(pair.coherence[0, 0]))
            error.append(
                spread(
                    float(theory.temporal_coherence(apart[-1], long_term, decay)),
                    pair.independent_looks,
                    True,
                )
            )
    order = np.argsort(apart)
    x = np.asarray(apart)[order]
    return Comparison(
        f"any two of {len(days)} passes: g = {long_term:g}, tau = {decay:g} days",
        x,
        theory.temporal_coherence(x, long_term, decay),
        np.asarray(got)[order],
        tolerance=float(3.5 * np.max(error)),
        reason="3.5 standard errors",
        unit="",
        shown=0,
    )


def temporal_statistics(quick: bool = False) -> Case:
    """Phase and sample coherence of small blocks of ground that changes."""
    phases, want, got, error = [], [], [], []
    for seed, gamma in enumerate((0.3, 0.7) if quick else (0.15, 0.3, 0.5, 0.7, 0.9)):
        pair = changed_pair(RadarSetting.drawn(seed + 80, cell=1.0), gamma, 0.0, 1.0)
        both = pair.interferogram((4, 4))
        label = f"phase: coherence {gamma:g}, {both.independent_looks:.1f} looks, {both.phase.size} blocks"
        phases.append(phase_law(label, both.phase, gamma, both.independent_looks))
        for looks in ((4, 4), (6, 6), (10, 10)):
            blocks = pair.interferogram(looks)
            want.append(theory.expected_coherence(gamma, blocks.independent_looks))
            got.append(float(blocks.coherence.mean()))
            error.append(float(blocks.coherence.std()) / np.sqrt(blocks.coherence.size))
    return Case(
        name="temporal_statistics",
        topic=TOPIC,
        title="Phase noise and sample coherence of ground that changes",
        formula="densities of the phase and of the sample coherence of n looks (2F1)",
        source="Lee et al., IEEE TGRS 32 (1994), eq. 20; Touzi et al., IEEE TGRS 37 (1999), eq. 9",
        x_label="phase (rad), or number",
        y_label="probability, or mean sample coherence",
        comparisons=(
            *phases,
            Comparison(
                "mean sample coherence of blocks, too large where looks and coherence are few",
                np.arange(len(want), dtype=np.float64),
                np.asarray(want),
                np.asarray(got),
                tolerance=float(4.0 * np.max(error) + 0.01),
                reason="4 standard errors; 0.01 for looks that are not quite independent",
                unit="",
                shown=0,
            ),
        ),
        note="No baseline: the mean phase is zero, and coherence and looks are predicted, not fitted.",
    )


def wall_over_field(quick: bool = False) -> Case:
    """Coherence of an unchanged wall laid over a field that changes."""
    want, got, error = [], [], []
    height, width = 20.0, 44.0
    for seed in range(1 if quick else 5):
        setting = RadarSetting.drawn(seed + 90, cell=0.75, look=(32.0, 48.0))
        rng = np.random.default_rng([seed, 2007])
        gamma, above = float(rng.uniform(0.0, 0.5)), float(rng.uniform(0.0, 8.0))
        field = replace(ROUGH, name="field", temporal_coherence=gamma)
        wall = replace(ROUGH, name="wall", diffuse_level_db=ROUGH.diffuse_level_db + above)
        meshes = [
            setting.parallelogram((-60.0, -50.0, 0.0), (120.0, 0.0, 0.0), (0.0, 100.0, 0.0)),
            setting.parallelogram((0.0, -width / 2, 0.0), (0.0, width, 0.0), (0.0, 0.0, height)),
        ]
        pair = pair_of(setting, meshes, 90.0, materials=(field, wall), baseline=0.0, days=1.0)
        single = pair.interferogram((1, 1))
        local = setting.local(single.positions())
        near = setting.slant_range - np.linalg.norm(
            single.positions() - pair.radars[0].track.center_position, axis=-1
        )
        deep = height * np.cos(setting.incidence)
        strip = np.abs(local[..., 1]) < 0.4 * width
        over = strip & (near > 0.1 * deep) & (near < 0.9 * deep)
        alone = strip & (near > 1.2 * deep) & (near < 1.2 * deep + 15.0)
        # surface in a slant-range cell: of the wall 1 / cos, of the ground 1 / sin of the incidence angle
        ratio = power_from_db(above) * np.tan(setting.incidence)
        for where, coherence in ((over, (ratio + gamma) / (ratio + 1.0)), (alone, gamma)):
            powers = [float(power[where].sum()) for power in single.powers]
            looks = where.sum() * whole(pair).independent_looks / single.values.size
            want.append(theory.rms_coherence(float(coherence), float(looks)))
            got.append(float(np.abs(single.values[where].sum()) / np.sqrt(powers[0] * powers[1])))
            error.append(spread(float(coherence), float(looks), False))
    return Case(
        name="wall_over_field",
        topic=TOPIC,
        title="A wall that stays over a field that changes",
        formula="(r + g) / (r + 1), r = power of the wall over that of the field in a range cell",
        source="powers of independent scatterers add up, and so do their cross products",
        x_label="wall laid over the field (even), field alone (odd)",
        y_label="coherence",
        comparisons=(
            Comparison(
                "walls of drawn levels over fields of drawn coherence",
                np.arange(len(want), dtype=np.float64),
                np.asarray(want),
                np.asarray(got),
                tolerance=float(3.5 * np.max(error)),
                reason="3.5 standard errors",
                unit="",
                shown=0,
            ),
        ),
        note=f"A wall of {height:g} m facing the radar; no baseline.",
    )


CASES.register(CaseEntry("temporal_decorrelation", TOPIC, temporal_decorrelation))
CASES.register(CaseEntry("temporal_statistics", TOPIC, temporal_statistics))
CASES.register(CaseEntry("wall_over_field", TOPIC, wall_over_field))
