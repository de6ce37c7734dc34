"""Metadata of raw data and images: the run that produced them."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict

from sarmitsuba.effects.plan import EffectsPlan
from sarmitsuba.scene.round_facets import RoundFacets
from sarmitsuba.simulation.execution.error_statement import image_theory, theory_witness
from sarmitsuba.simulation.execution.run import Run
from sarmitsuba.simulation.planning.prediction.speed import ray_share
from sarmitsuba.simulation.planning.sampling.density_plan import SamplingPlan

# largest number of ideal points listed in the metadata, for measurements of image quality
_MOST_POINTS = 256


def raw_metadata(run: Run, plan: EffectsPlan, notes: Sequence[str]) -> dict[str, object]:
    """Metadata of raw data."""
    scene = run.scene
    return {
        **_common(run, plan, notes, run.sampling),
        "scene_path": str(scene.path) if scene.path else None,
        "sampling": run.report.as_dict() if run.report else {},
    }


def image_metadata(
    run: Run, method: str, focus: Mapping[str, object], sampling: SamplingPlan | None
) -> dict[str, object]:
    """Metadata of an image made without raw data; ``focus``: description of its impulse response and grid."""
    return {
        **_common(run, run.plan, run.notes, sampling),
        "method": method,
        "image_request": run.scene.image.as_dict(),
        "focus": dict(focus),
    }


def _common(
    run: Run, plan: EffectsPlan, notes: Sequence[str], sampling: SamplingPlan | None
) -> dict[str, object]:
    theory = image_theory(run.scene, plan.flags)
    burst = run.scene.radar.burst
    return {
        **({} if burst is None else {"burst": asdict(burst)}),
        "scene": run.scene.name,
        "settings": {k: v for k, v in vars(run.scene.settings).items() if k != "effects"},
        "effects": dict(plan.as_dict()),
        "plan": plan.summary(),
        "statistics": dict(vars(run.statistics)),
        "seconds": dict(run.timer.seconds),
        "processor_seconds": dict(run.timer.processor),
        "ray_spacing_settings": sampling.spacings.at(1.0) if sampling else {},
        "ray_share_of_tracing": ray_share(run.statistics, len(run.layers.subsets)),
        "witnesses": {
            **{stage: witness.as_dict() for stage, witness in run.witnesses.items()},
            **theory_witness(theory),
        },
        "notes": list(notes),
        "theory": theory,
        "facets": RoundFacets.of(
            run.scene.geometry, run.scene.materials, run.scene.radar.waveform.wavelength
        ).as_dict(),
        "points": [
            {
                "name": point.name,
                "position": [float(v) for v in point.position + run.scene.offset],
                "rcs": point.rcs,
                "phase": point.phase,
                "velocity": list(point.motion.velocity),
                "acceleration": list(point.motion.acceleration),
            }
            for point in run.scene.points[:_MOST_POINTS]
        ],
        "moving": {
            name: {"velocity": list(motion.velocity), "acceleration": list(motion.acceleration)}
            for name, motion in zip(
                run.scene.geometry.mesh_names, run.scene.geometry.mesh_motion, strict=False
            )
            if not motion.still
        },
    }
