"""Rays through the scatterer cells in a cost study: what leaving all ray spacings out gives on bare level ground."""

from collections.abc import Sequence
from dataclasses import replace

from sarmitsuba.cost.proof import Proof
from sarmitsuba.cost.report import Candidate
from sarmitsuba.cost.trial import Changes
from sarmitsuba.effects.plan import EffectsPlan
from sarmitsuba.scene.scene import Scene
from sarmitsuba.simulation.pilot import plan_scene

# what combinations of the sweeps ask for and these do not; one bounce is proven where cells are
LEFT_OUT = ("ray_spacing", "diffuse_ray_spacing", "max_depth")


def has_cells(scene: Scene, plan: EffectsPlan) -> bool:
    """Whether rays go through the scatterer cells when no spacing is asked for; ``plan``: of the scene as loaded."""
    if scene.settings.keep_subsets:
        plan = plan_scene(replace(scene, settings=replace(scene.settings, keep_subsets=False)))
    return plan.flags.diffuse and not plan.flags.footprint_splitting


def measure_cells(proof: Proof, changes: Changes, seconds: float, deadline: float) -> list[Candidate]:
    """Run a combination without its spacings if there is time; ``seconds``: about what it takes."""
    if proof.clock.now() + proof.cost(seconds) > deadline:
        return []
    own = {k: v for k, v in changes.items() if k not in LEFT_OUT}
    check = proof.measure(own)
    return [Candidate(own, check.error_db, check.seconds, True)]


def cells_text(found: Sequence[Candidate]) -> str:
    """What to do about it; ``found``: what was measured."""
    text = (
        "bare level ground: without ray_spacing and diffuse_ray_spacing the rays go through the scatterer cells, which "
        "no setting with spacings does and which is cheaper for its density; leave spacings out"
    )
    if not found:
        return text + " (not measured: the budget ended before)"
    return text + ": " + ", ".join(f"{c.changes['method']} {c.estimate()}" for c in found) + " (measured)"


__all__ = ["cells_text", "has_cells", "measure_cells"]
