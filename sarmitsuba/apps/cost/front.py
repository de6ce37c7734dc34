"""Measurement of the Pareto front, starting near the wanted error."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from sarmitsuba.apps.cost.model import corrected
from sarmitsuba.apps.cost.proof import Proof, ProofRun
from sarmitsuba.apps.cost.report import Candidate, pareto, recommend

# largest error of interest, dB; share of the remaining time for a single combination far from the target
USELESS_DB, FAR_SHARE = -10.0, 0.35


def measure_front(
    predicted: Sequence[Candidate],
    proof: Proof,
    target_error_db: float,
    deadline: float,
    progress: Callable[[], None],
    own: int | None = None,
) -> list[Candidate]:
    """Measure the combinations on the Pareto front within the time, those near the target first.

    Parameters
    ----------
    predicted : all combinations, from the model
    proof : measures the combinations
    target_error_db : wanted error
    deadline : on the proof's clock
    progress : called after every run
    own : index of the scene's own setting, whose seconds are measured already; None: it is not measured

    Returns
    -------
    candidates : measured, or corrected by measured neighbours
    """
    measured: dict[int, ProofRun] = {}
    skipped: set[int] = set()
    if own is not None:
        measured[own] = replace(proof.measure(predicted[own].changes), seconds=predicted[own].seconds)
        progress()
    while True:
        candidates = corrected(predicted, measured)
        index = {id(c): i for i, c in enumerate(candidates)}
        front = pareto(candidates)
        mine = candidates[own] if own is not None else None
        chosen = recommend(candidates, target_error_db, own=mine).setting
        place = next((i for i, c in enumerate(front) if c is chosen), len(front) - 1)
        near = [chosen, *front[max(0, place - 1) : place + 2]]
        # the recommendation, the next cheaper, the next better, then the combination farthest from any measured one
        known = [np.log(check.seconds) for check in measured.values()]
        far = sorted(
            (c for c in front if c.error_db <= max(target_error_db, USELESS_DB)),
            key=lambda c: -min((abs(np.log(c.seconds) - k) for k in known), default=0.0),
        )
        todo = [c for c in (*near, *far) if not c.measured and index[id(c)] not in skipped]
        if not todo:
            return candidates
        pick = todo[0]
        left = deadline - proof.trials.clock.now() - proof.cost(chosen.seconds)
        if proof.cost(pick.seconds) > (left if any(pick is c for c in near) else FAR_SHARE * left):
            skipped.add(index[id(pick)])
            continue
        measured[index[id(pick)]] = proof.measure(pick.changes, expected=pick.seconds)
        progress()
