"""Measurement of the Pareto front, starting near the wanted error."""

from collections.abc import Callable, Sequence

import numpy as np

from sarmitsuba.cost.model import corrected
from sarmitsuba.cost.proof import Proof, ProofRun
from sarmitsuba.cost.report import Candidate, pareto, recommend

# no image so wrong is wanted, dB; most of the time left that one combination far from the target may take
USELESS_DB, FAR_SHARE = -10.0, 0.35


def measure_front(
    predicted: Sequence[Candidate],
    proof: Proof,
    target_error_db: float,
    deadline: float,
    progress: Callable[[], None],
) -> list[Candidate]:
    """Run the combinations on the Pareto front while there is time, what the target depends on first.

    Parameters
    ----------
    predicted : all combinations, from the model
    proof : runs them
    target_error_db : wanted
    deadline : on the proof's clock
    progress : called after every run

    Returns
    -------
    candidates : measured, or corrected by their measured neighbours
    """
    measured: dict[int, ProofRun] = {}
    skipped: set[int] = set()
    while True:
        candidates = corrected(predicted, measured)
        index = {id(c): i for i, c in enumerate(candidates)}
        front = pareto(candidates)
        chosen = recommend(candidates, target_error_db).setting
        place = next((i for i, c in enumerate(front) if c is chosen), len(front) - 1)
        near = [chosen, *front[max(0, place - 1) : place + 2]]
        # the recommendation, the next cheaper, the next better, then what is least like anything measured
        known = [np.log(check.seconds) for check in measured.values()]
        far = sorted(
            (c for c in front if c.error_db <= max(target_error_db, USELESS_DB)),
            key=lambda c: -min((abs(np.log(c.seconds) - k) for k in known), default=0.0),
        )
        todo = [c for c in (*near, *far) if not c.measured and index[id(c)] not in skipped]
        if not todo:
            return candidates
        pick = todo[0]
        left = deadline - proof.clock.now() - proof.cost(chosen.seconds)
        if proof.cost(pick.seconds) > (left if any(pick is c for c in near) else FAR_SHARE * left):
            skipped.add(index[id(pick)])
            continue
        measured[index[id(pick)]] = proof.measure(pick.changes)
        progress()
