"""An effect that is off leaves nothing in the kernel, and any subset of effects runs."""

import re
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from sarmitsuba.effects.catalog.full_wave import FULL_WAVE
from sarmitsuba.effects.effect import switchable_effects
from sarmitsuba.effects.flags import KernelFlags
from sarmitsuba.effects.plan import EffectsPlan
from sarmitsuba.loading.library import resolve
from sarmitsuba.loading.load import load_scene
from sarmitsuba.radar.antenna import Antenna
from sarmitsuba.scene.materials.material import Material
from sarmitsuba.scene.scene import Scene
from sarmitsuba.simulation.execution.render import simulate

# switches of the kernel that an effect of the plan sets
SWITCHES = (
    "fresnel",
    "roughness",
    "coherent",
    "diffuse",
    "diffuse_double",
    "speckle",
    "depolarisation",
    "antenna_pattern",
    "spreading",
    "visibility",
    "tube_phase",
    "multi_bounce",
)
# images refuse solved currents
EFFECT_SWITCHES = [effect.name for effect in switchable_effects() if effect.name != FULL_WAVE]
ROUGH = Material(
    "rough",
    permittivity=5.0 - 0.5j,
    rms_height=0.003,
    diffuse_law="lambert",
    diffuse_level_db=-10.0,
    cross_polar_ratio_db=-12.0,
)


@pytest.fixture(scope="module")
def tiny() -> Scene:
    """The dihedral in rough concrete, under a beam, with receiver noise; a few thousand rays."""
    scene = load_scene(resolve("dihedral"))
    radar = replace(
        scene.radar,
        channels=("HH", "HV"),
        antenna=Antenna("gaussian", 1.0, 1e-3, 1e-3),
        noise_temperature=290.0,
    )
    # one lattice for all returns, so that one kernel holds all effects
    settings = replace(
        scene.settings, ray_spacing=0.03, diffuse_ray_spacing=0.03, scatterer_cell=0.3, gridding_width=2
    )
    return replace(scene, radar=radar, materials=(ROUGH,), settings=settings)


@pytest.fixture
def history() -> Iterator[Any]:
    """Dr.Jit's record of the kernels that ran."""
    import drjit as dr

    from sarmitsuba.machine.backend import ensure_backend

    ensure_backend()
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        dr.kernel_history_clear()
        yield dr
        dr.kernel_history_clear()


# arithmetic in LLVM's intermediate code. Memory access is left out: Dr.Jit gathers a table's row in one packet or in
# single words depending on where in memory the table happens to lie
ARITHMETIC = re.compile(r"= (?:f\w+ |xor |lshr |[su]itofp |call [^@]*@llvm\.(?!masked))|call void %")


def kernel_size(dr: Any, scene: Scene, flags: KernelFlags) -> int:
    """Arithmetic instructions and ray queries of the trace kernel, the largest kernel that ran."""
    dr.kernel_history_clear()
    simulate(scene, plan=EffectsPlan(flags, 3))
    codes = [k["ir"].getvalue() for k in dr.kernel_history() if "ir" in k]
    return max(len(ARITHMETIC.findall(code)) for code in codes)


def test_every_effect_switched_off_shrinks_the_kernel(tiny: Scene, history: Any) -> None:
    one = replace(tiny, radar=replace(tiny.radar, channels=("HH",)))  # smaller kernels compile sooner
    full = KernelFlags(channels=("HH",), polarised_diffuse=False, taper=False)
    size = kernel_size(history, one, full)
    table = {"everything": size}
    for name in SWITCHES:
        table[name] = kernel_size(history, one, replace(full, **{name: False}))
    print("\n".join(f"{name:16s} {lines:6d} {lines - size:6d}" for name, lines in table.items()))
    # whether 1/R^2 varies enough depends on the look: chosen by a number, so that no look compiles a kernel of its own
    assert table.pop("spreading") == size
    assert all(lines < size for name, lines in table.items() if name != "everything"), table
    assert kernel_size(history, tiny, replace(full, channels=tiny.radar.channels)) > size  # a channel more


@pytest.mark.filterwarnings(
    "ignore::sarmitsuba.core.errors.SarmitsubaWarning"
)  # of rays without the phase of tubes
def test_an_effect_without_work_leaves_the_same_kernel(tiny: Scene, history: Any) -> None:
    """Switching on what another switch made void adds no instruction: nothing of it is left to pay for."""
    bare = KernelFlags(
        channels=("HH",),
        diffuse=False,
        diffuse_double=False,
        speckle=False,
        multi_bounce=False,
    )
    bare = replace(bare, depolarisation=False, polarised_diffuse=False, taper=False, visibility=False)
    one = replace(tiny, radar=replace(tiny.radar, channels=("HH",)))
    with_words = replace(
        bare,
        diffuse_double=True,
        speckle=True,
        depolarisation=True,
        visibility=True,
    )
    assert kernel_size(history, one, bare) == kernel_size(history, one, with_words)


@pytest.mark.filterwarnings("ignore::sarmitsuba.core.errors.SarmitsubaWarning")
@pytest.mark.parametrize(
    "seed", [0, 1, 2, *(pytest.param(seed, marks=pytest.mark.slow) for seed in range(3, 8))]
)
def test_any_subset_runs(tiny: Scene, seed: int) -> None:
    rng = np.random.default_rng(seed)
    effects = {name: str(rng.choice(["auto", "on", "off"])) for name in EFFECT_SWITCHES}
    if effects["diffuse"] == "off":  # without both nothing returns, which is refused
        effects["coherent"] = "on"
    depth = int(rng.integers(0, 4))
    settings = replace(tiny.settings, effects=effects, max_depth=depth)  # type: ignore[arg-type]
    raw = simulate(replace(tiny, settings=settings))
    assert np.isfinite(raw.data).all() and np.any(raw.data)
    plan = raw.metadata["effects"]["effects"]
    for name, switch in effects.items():
        assert switch == "auto" or plan[name]["on"] == (switch == "on")
    assert raw.channels == (("HH",) if not plan["cross_polarisation"]["on"] else ("HH", "HV"))
    assert (raw.radar.antenna.pattern == "isotropic") == (not plan["antenna_pattern"]["on"])
    assert (raw.radar.noise_temperature == 0.0) == (not plan["noise"]["on"])
