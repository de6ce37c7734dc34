"""The effects plan: what the kernel will simulate for this scene, and why."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from sarmitsuba.effects.flags import KernelFlags
from sarmitsuba.scene.spec import Scene

# bounces that are traced when nothing speaks for fewer: wall-ground-wall is the last one that maps above
# the clutter in built-up scenes
DEFAULT_DEPTH = 3


@dataclass(frozen=True)
class Decision:
    """One effect: on or off, and why.

    Parameters
    ----------
    name : of the effect
    on : whether it is simulated
    why : the fact in the scene or radar, or the explicit setting, that decided
    value : for effects that are a number (bounce depth), else None
    """

    name: str
    on: bool
    why: str
    value: int | None = None


@dataclass(frozen=True)
class EffectsPlan:
    """Everything later stages obey.

    Parameters
    ----------
    flags : what is compiled into the kernel
    max_depth : most bounces
    decisions : one an effect
    """

    flags: KernelFlags
    max_depth: int
    decisions: tuple[Decision, ...] = field(default_factory=tuple)

    def summary(self) -> str:
        """One line: bounces and the effects that are on and off."""
        on = [d.name for d in self.decisions if d.on and d.value is None]
        off = [d.name for d in self.decisions if not d.on]
        return f"max_depth {self.max_depth}; on: {', '.join(on) or 'none'}; off: {', '.join(off) or 'none'}"

    def as_dict(self) -> Mapping[str, Any]:
        """JSON-able form."""
        return {
            "max_depth": self.max_depth,
            "effects": {d.name: {"on": d.on, "why": d.why} for d in self.decisions},
        }


def plan_effects(scene: Scene) -> EffectsPlan:
    """Decide every effect from static facts of the scene and the radar; explicit settings win."""
    used = sorted(set(scene.geometry.face_material.tolist()))
    materials = [scene.materials[i] for i in used if not scene.materials[i].invisible]
    wanted = scene.settings.effects
    decisions: list[Decision] = []

    def decide(name: str, needed: bool, yes: str, no: str) -> bool:
        switch = wanted.get(name, "auto")
        if switch != "auto":
            on = switch == "on"
            decisions.append(Decision(name, on, f"set {switch} by the user"))
            return on
        decisions.append(Decision(name, needed, yes if needed else no))
        return needed

    dielectric = [m.name for m in materials if not m.pec]
    rough = [m.name for m in materials if m.rms_height > 0]
    diffuse = [m.name for m in materials if m.diffuse_law != "none"]
    cross = [m.name for m in materials if m.diffuse_law != "none" and m.cross_polar_ratio_db > -60.0]
    polarised = [
        m.name for m in materials if m.diffuse_law in ("small_perturbation", "iem", "roughness") and not m.pec
    ]
    channels = scene.radar.channels
    depth = scene.settings.max_depth or DEFAULT_DEPTH
    single_facet_group = len(set(scene.geometry.face_group.tolist())) == 1 and _flat(scene)
    if scene.settings.max_depth == 0 and single_facet_group:
        depth = 1
    decisions.append(
        Decision(
            "max_depth",
            depth > 1,
            "set by the user" if scene.settings.max_depth else
            ("one flat surface cannot reflect onto itself" if depth == 1 else "default for several surfaces"),
            depth,
        )
    )
    many = depth > 1
    diffuse_on = decide("diffuse", bool(diffuse), f"diffuse law on {_names(diffuse)}", "no material scatters diffusely")
    flags = KernelFlags(
        channels=channels,
        fresnel=decide("fresnel", bool(dielectric), f"dielectric {_names(dielectric)}", "all conductors are perfect"),
        roughness=decide("roughness", bool(rough), f"rms height on {_names(rough)}", "every surface is smooth"),
        coherent=True,
        diffuse=diffuse_on,
        diffuse_double=decide(
            "diffuse_double", diffuse_on and many, "diffuse hits behind mirrors", "no diffuse hit behind a mirror"
        ),
        speckle=decide("speckle", diffuse_on, "diffuse cells carry speckle", "nothing diffuse"),
        depolarisation=decide(
            "depolarisation",
            diffuse_on and bool(cross),
            f"cross-polar ratio on {_names(cross)}",
            "no diffuse cross-polar return",
        ),
        polarised_diffuse=diffuse_on and bool(polarised),
        antenna_pattern=decide(
            "antenna_pattern",
            scene.radar.antenna.pattern != "isotropic",
            f"{scene.radar.antenna.pattern} beam",
            "isotropic beam",
        ),
        spreading=decide("spreading", True, "ranges differ within the scene", ""),
        visibility=decide("visibility", many, "later hits can be hidden from the antenna", "one bounce sees home"),
        tube_phase=decide("tube_phase", True, "tubes are wider than a wavelength", ""),
        double_phase=scene.settings.phase_precision == "double",
        taper=True,
        multi_bounce=many,
    )
    decide("noise", scene.radar.noise_temperature > 0, "noise temperature given", "no noise temperature given")
    return EffectsPlan(flags, depth, tuple(decisions))


def _names(names: list[str], most: int = 3) -> str:
    head = ", ".join(names[:most])
    return head + (f" and {len(names) - most} more" if len(names) > most else "")


def _flat(scene: Scene) -> bool:
    """All vertices in one plane, to a nanometre of the extent."""
    import numpy as np

    v = scene.geometry.vertices
    if v.shape[0] < 3:
        return False
    centred = v - v.mean(axis=0)
    return bool(np.linalg.svd(centred.T @ centred, compute_uv=False)[-1] <= 1e-18 * max(1.0, np.square(v).sum()))


__all__ = ["DEFAULT_DEPTH", "Decision", "EffectsPlan", "plan_effects"]
