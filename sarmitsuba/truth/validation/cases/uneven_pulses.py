"""PRF jitter and staggered PRF: side lobes and ghosts of a focused point."""

import numpy as np

from sarmitsuba.core.arrays import F64
from sarmitsuba.core.units import db_from_power
from sarmitsuba.scene.geometry import PointTarget
from sarmitsuba.signal.focusing.focusers.backprojection import backproject
from sarmitsuba.simulation.execution.render import simulate
from sarmitsuba.truth import theory
from sarmitsuba.truth.validation.cases import CASES, CaseEntry
from sarmitsuba.truth.validation.chain import Parameter, make_scene, suppress_warnings
from sarmitsuba.truth.validation.comparison import Case, Comparison

RANGE, SPEED, PRF, FREQUENCY = 10e3, 100.0, 100.0, 9.65e9
WAVELENGTH = 299792458.0 / FREQUENCY
APART = WAVELENGTH * RANGE * PRF / (2.0 * SPEED)  # of even pulses' ghosts, m


def response(turns: F64, n_pulses: int, **timing: Parameter) -> F64:
    """Power of the image at Doppler offsets (n,) in prf from a point, relative to the point."""
    values: dict[str, Parameter] = {
        "mode": "spotlight",
        "slant_range": RANGE,
        "look_angle_deg": 40.0,
        "heading_deg": 62.0,
        "speed": SPEED,
        "prf": PRF,
        "n_pulses": n_pulses,
        "center_frequency": FREQUENCY,
        "bandwidth": 2e6,
        "image_extent_azimuth": 3.0 * APART,
        "image_extent_range": 300.0,
        **timing,
    }
    with suppress_warnings():  # of the prf, which is the point
        scene = make_scene(None, (), values, points=(PointTarget("p", np.zeros(3), 1.0),))
        raw = simulate(scene)
    along = raw.radar.track.along
    places = np.concatenate([[0.0], turns * APART])
    power = np.abs(backproject(raw, scene.points[0].position + places[:, None] * along)[0]) ** 2
    return np.asarray(power[1:] / power[0])


def prf_jitter(quick: bool = False) -> Case:
    """Noise-like side lobes and smeared ghosts of random intervals."""
    n, seeds = 128, 16 if quick else 60
    centers = np.array([0.15, 0.35, 0.5, 0.75, 1.0])
    comparisons = []
    for jitter in (0.05, 0.15):
        # half a cell apart over 16 cells; the ghost is narrower than that where it is not smeared
        spread = np.where(centers[:, None] == 1.0, 0.0, 1.0) * np.arange(-16, 16) * 0.5 / n
        turns = centers[:, None] + spread
        found = np.mean(
            [
                response(turns.ravel(), n, prf_jitter=jitter, prf_jitter_seed=seed).reshape(turns.shape)
                for seed in range(seeds)
            ],
            axis=(0, 2),
        )
        closed = theory.jittered_response(turns, jitter, n).mean(axis=1)
        comparisons.append(
            Comparison(
                f"jitter {jitter:g}",
                centers,
                db_from_power(closed),
                db_from_power(np.asarray(found)),
                tolerance=1.5 if quick else 1.2,
                reason=f"Monte Carlo: {seeds} seeds of 32 offsets (one at the ghost)",
                unit="dB",
                shown=2,
            )
        )
    return Case(
        name="prf_jitter",
        topic="antenna",
        title="PRF jitter: noise-like side lobes, smeared ghosts",
        formula="1/n + 2/n^2 Re sum (n - m) chi^m, chi = exp(-j 2 pi f T - (2 pi f T jitter)^2 / 2)",
        source="Beutler and Leneman, Information and Control 12, 1968 (spectra of impulse processes)",
        x_label="Doppler offset from the point over the prf",
        y_label="power over the point's (dB)",
        comparisons=tuple(comparisons),
        note=f"{n} pulses of independent Gaussian intervals, focused at their own positions; even pulses have their "
        "ghost at 1, of 0 dB.",
    )


def staggered_prf(quick: bool = False) -> Case:
    """Ghosts of staggered pulse intervals."""
    comparisons = []
    sequences: dict[str, F64] = {
        "0.8,1,1.2": np.array([0.8, 1.0, 1.2]),
        "ramp:8:0.6": np.linspace(1.3, 0.7, 8),
    }
    if not quick:
        sequences["ramp:32:1"] = np.linspace(1.5, 0.5, 32)
    for text, steps in sequences.items():
        order = np.arange(1, steps.size + 1)
        found = response(
            order / steps.size, 4 * steps.size * (8 if steps.size < 16 else 2), pri_sequence=text
        )
        comparisons.append(
            Comparison(
                text,
                order / steps.size,
                db_from_power(theory.staggered_line(steps, order)),
                db_from_power(found),
                tolerance=0.3,
                reason="curvature over the aperture; nulls are finer than this",
                unit="dB",
                floor=25.0,
            )
        )
    return Case(
        name="staggered_prf",
        topic="antenna",
        title="Staggered PRF: one ghost becomes many weak ones",
        formula="|1/M sum_m exp(-j 2 pi k t_m / t_M)|^2 at k / M of the prf",
        source="Jenq, IEEE Trans. Instrum. Meas. 37, 1988 (periodic non-uniform sampling)",
        x_label="Doppler offset from the point over the prf",
        y_label="ghost over point (dB)",
        comparisons=tuple(comparisons),
        note="Intervals as pri_sequence gives them; even pulses have their ghost at 1, of 0 dB.",
    )


CASES.register(CaseEntry("prf_jitter", "antenna", prf_jitter))
CASES.register(CaseEntry("staggered_prf", "antenna", staggered_prf))
