"""What the trace kernel promises to its accumulators, and the arrays that reach it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from sarmitsuba.effects.context import KINDS
from sarmitsuba.loading.library import resolve
from sarmitsuba.loading.load import load_scene
from sarmitsuba.machine.backend import dr, ensure_backend, mi
from sarmitsuba.radar.antenna import Antenna
from sarmitsuba.tracing.kernel.accumulators import rounded_size
from sarmitsuba.tracing.kernel.device_arrays import device_array
from sarmitsuba.tracing.kernel.kernel import KernelSettings, trace
from sarmitsuba.tracing.kernel.launch import PulseBatch, frame_towards, lattice
from sarmitsuba.tracing.kernel.scene_tables import build_trace_scene
from sarmitsuba.tracing.kernel.state import COHERENT, DIFFUSE, RECIPROCAL, Contribution, Kernel
from tests.support.paths import coherent_flags


class Tally:
    """Counts every lane's contributions by kind, and those of an order that the kind cannot have."""

    def begin(self) -> tuple[mi.UInt32, ...]:
        return (mi.UInt32(0),) * 4

    def add(self, state: tuple[mi.UInt32, ...], contribution: Contribution) -> tuple[mi.UInt32, ...]:
        kind, order = contribution.kind, contribution.order
        even = ((order & 1) == 0) | (order < 3)
        seen = [kind == k for k in (COHERENT, DIFFUSE, RECIPROCAL)] + [(kind == RECIPROCAL) & even]
        return tuple(
            s + dr.select(contribution.active & new, mi.UInt32(1), 0)
            for s, new in zip(state, seen, strict=True)
        )


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"coherent": False},
        {"diffuse": False},
        {"diffuse_double": False},
        {"multi_bounce": False},
    ],
    ids=lambda c: next(iter(c), "all"),
)
def test_every_contribution_arrives_once(changes: dict[str, bool]) -> None:
    """The accumulator sees as many contributions as the kernel counts, of the kinds that are on and no other."""
    ensure_backend()
    scene = load_scene(resolve("tower"))
    radar = scene.radar
    middle = radar.track.center_index
    position, velocity = radar.track.position[middle][None], radar.track.velocity[middle][None]
    frame = frame_towards(position, scene.geometry.bounds.mean(axis=0), velocity[0])
    rays = lattice(10.0, 10.0, 0.8)
    flags = coherent_flags(scene.materials, ("HH", "VV"), 3, diffuse=True)
    flags = replace(flags, **changes)
    wavelength = radar.waveform.wavelength
    settings = KernelSettings(wavelength, 3, cell=0.7, seed=1, amplitude=1.0, reference_range=1e4)
    built = build_trace_scene(scene.geometry, scene.materials, wavelength)
    kernel = Kernel.of(built, rays, PulseBatch(position, velocity, frame), flags, settings)
    counts, state = trace(kernel, Antenna(), Tally())
    dr.eval(counts, state)
    coherent, diffuse, reciprocal, wrong_order = (int(np.sum(s.numpy())) for s in state)
    assert coherent + diffuse + reciprocal == int(np.sum(counts.contributions.numpy())) > rays.n_rays // 2
    assert (coherent > 0) == flags.coherent
    assert (diffuse > 0) == flags.diffuse
    assert (reciprocal > 0) == (flags.diffuse and flags.diffuse_double and flags.multi_bounce)
    assert wrong_order == 0


def test_kinds_are_numbered_as_the_effects_name_them() -> None:
    assert [KINDS[k] for k in (COHERENT, DIFFUSE, RECIPROCAL)] == ["coherent", "diffuse", "reciprocal"]


def test_arrays_compile_one_kernel_wherever_numpy_put_them() -> None:
    """Views of every alignment give one and the same kernel."""
    ensure_backend()
    base = np.arange(1000, dtype=np.float64)

    def kernels(array_of: Callable[[np.ndarray], mi.Float64]) -> set[str]:
        hashes = set()
        with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
            for first in range(8):
                dr.kernel_history_clear()
                view = base[first : first + 900]
                doubled = array_of(view) * 2.0
                dr.eval(doubled)
                hashes |= {entry["hash"] for entry in dr.kernel_history([dr.KernelType.JIT])}
                assert np.array_equal(doubled.numpy(), 2.0 * view)
        return hashes

    assert len(kernels(lambda view: device_array(mi.Float64, view))) == 1
    if mi.variant().startswith("llvm"):
        assert len(kernels(mi.Float64)) > 1  # what the copy is for


def test_grid_sizes_are_few_and_never_too_small() -> None:
    sizes = np.unique(np.geomspace(1, 2e8, 4000).astype(int))
    rounded = np.array([rounded_size(int(n)) for n in sizes])
    assert (rounded >= sizes).all()
    assert np.unique(rounded[sizes <= 2**22]).size == 3
    assert (rounded[sizes > 2**22] < 2 * sizes[sizes > 2**22]).all()
    assert (rounded & (rounded - 1) == 0).all()
