"""Choice of the scene's parts for the sweeps and for the verification of a cost study."""

from collections.abc import Mapping

from sarmitsuba.apps.cost.trial import Trial, TrialSetting
from sarmitsuba.apps.cost.trials import Trials
from sarmitsuba.scene.scene import Scene
from sarmitsuba.simulation.planning.sampling.piece import crop

# shares of the budget: for the sweeps, and largest share for the reference
SWEEP_SHARE, PROOF_SHARE = 0.55, 0.25
# cost of all sweeps and of the reference, in runs of the plain setting: each setting runs once, on shared geometry
SWEEP_RUNS = 36.0
# seconds of a run of the whole scene below which smaller pieces are hardly faster: launches and planning remain
SHORT = 10.0
# budget, in runs of the whole scene, below which sweeps and combinations have the same reference
SHORT_STUDY = 40.0
# candidate pieces of a scene: share of the image's extents, share of the pulses
_PIECES = (
    (1.0, 1.0),
    (0.7, 1.0),
    (0.5, 1.0),
    (0.35, 1.0),
    (0.35, 0.5),
    (0.25, 0.5),
    (0.25, 0.25),
    (0.15, 0.25),
)
# candidate references: share of the image's extents, ray spacing relative to the automatic one; best first. Denser than
# every candidate setting: at equal density it would share their errors
REFERENCES = ((1.0, 0.5), (1.0, 0.6), (0.7, 0.5), (0.7, 0.6), (0.5, 0.5), (0.5, 0.6), (0.35, 0.6))


def piece_to_sweep(
    scene: Scene, base: TrialSetting, budget: float, whole_seconds: float, trials: Trials
) -> tuple[Scene, str, Trial]:
    """Largest piece of the scene whose sweeps fit the budget, its description, and a timed run of it.

    Parameters
    ----------
    whole_seconds : s, estimate for the whole scene
    """
    allowed = SWEEP_SHARE * budget / SWEEP_RUNS
    guess = whole_seconds
    n = scene.radar.track.n_pulses
    steps = [(s, p) for s, p in _PIECES if p == 1.0 or n * p >= 64]
    if whole_seconds < SHORT:
        steps = [(s, p) for s, p in steps if p == 1.0]
    index = next((i for i, (s, p) in enumerate(steps) if guess * s * s * p <= allowed), len(steps) - 1)
    while True:
        share, pulses = steps[index]
        piece = scene if share >= 1.0 else crop(scene, share, pulses)
        plain = trials.steady(piece, base)
        if plain.seconds <= 1.5 * allowed or index == len(steps) - 1:
            break
        fall = plain.seconds / allowed / (share**2 * pulses)
        smaller = range(index + 1, len(steps))
        index = next((i for i in smaller if fall * steps[i][0] ** 2 * steps[i][1] <= 1.0), len(steps) - 1)
    if share >= 1.0:
        return scene, "the whole scene", plain
    text = _middle(piece)
    text += (
        ", the whole aperture"
        if pulses == 1.0
        else f", the middle {piece.radar.track.n_pulses} of {n} pulses"
    )
    return piece, text, plain


def _middle(piece: Scene) -> str:
    return f"the middle {piece.image.extent_azimuth:.3g} m x {piece.image.extent_range:.3g} m of the image"


def field_of_proof(
    scene: Scene, full: Mapping[str, float], budget: float, left: float
) -> tuple[Scene | None, float, str]:
    """Part of the scene for measuring the estimates, and the relative ray spacing of its reference.

    As large and as densely sampled as a quarter of the budget allows; None if less than a third of the image's extents,
    and for small budgets: the swept piece and its reference serve.

    Parameters
    ----------
    full : seconds by stage of the plain setting on the whole scene
    budget, left : s, of the whole study, and its remainder
    """
    if budget < SHORT_STUDY * sum(full.values()):  # a second reference would take what the combinations need
        return None, 0.0, ""
    allowed = min(PROOF_SHARE * budget, 0.6 * left)
    fixed = full.get("build", 0.0) + full.get("plan", 0.0)
    for share, factor in REFERENCES:
        # two passes with twice the key pulses
        rays = 2.0 * full["rays"] / factor**2
        others = 2.0 * (sum(full.values()) - full["rays"] - fixed)
        if 2.0 * (fixed + share**2 * (rays + others)) <= allowed:
            if share == 1.0:
                return scene, factor, "the whole scene"
            piece = crop(scene, share)
            return piece, factor, _middle(piece) + ", the whole aperture"
    return None, 0.0, ""
