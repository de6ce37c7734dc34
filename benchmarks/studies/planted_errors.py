"""Plant one error at a time into the running simulator and show which validation case catches it.

Nothing is changed on disk: functions of the kernel, the accumulators and the focuser are replaced in this process only.
Every case is run unharmed first. Exit status 1 when a case fails unharmed or an error gets through all of its cases.
"""

import argparse
import sys
import warnings
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import replace
from typing import Any
from unittest.mock import patch

import numpy as np

from sarmitsuba.core.errors import SarmitsubaWarning
from sarmitsuba.machine.backend import dr, ensure_backend, mi
from sarmitsuba.truth.validation.cases import CASES
from sarmitsuba.truth.validation.run_cases import run_case


@contextmanager
def _replaced(owner: Any, name: str, make: Callable[[Any], Any]) -> Iterator[None]:
    """Replace ``owner.name`` by ``make(original)``."""
    with patch.object(owner, name, make(getattr(owner, name))):
        yield


def dropped_factor_two() -> AbstractContextManager[None]:
    from sarmitsuba.tracing.kernel import field

    # half of the 2 n x H of physical optics
    return _replaced(
        field, "po_current_pec", lambda f: lambda *a, **k: tuple(part * 0.5 for part in f(*a, **k))
    )


def flipped_phase_sign() -> AbstractContextManager[None]:
    return _phase_factors(lambda f: lambda *a: dr.conj(f(*a)))


def one_way_phase() -> AbstractContextManager[None]:
    # exp(-j 2 pi R / lambda): the way back is forgotten
    return _phase_factors(lambda f: lambda x, w: f(x, 2.0 * w))


def _phase_factors(make: Callable[[Any], Any]) -> AbstractContextManager[None]:
    """Replace the phase of a path in every module that forms it."""
    from sarmitsuba.simulation.planning import pilot as pilot_patches
    from sarmitsuba.tracing.kernel import accumulators

    return _all(*(_replaced(module, "phase_factor", make) for module in (accumulators, pilot_patches)))


def float32_phase() -> AbstractContextManager[None]:
    from sarmitsuba.tracing.kernel import accumulators
    from sarmitsuba.tracing.kernel.accumulators import ImageAccumulator

    # lengths to the antenna, not differences, in single precision
    def make(f: Any) -> Any:
        return lambda self, state, c: f(self, state, replace(c, slant_range=_single(c.slant_range)))

    return _all(
        _replaced(accumulators.SumAccumulator, "add", make),
        _replaced(accumulators.DirectAccumulator, "add", make),
        _replaced(accumulators.BlockAccumulator, "add", make),
        _replaced(ImageAccumulator, "add", make),
    )


def _single(x: Any) -> Any:
    return mi.Float64(mi.Float(x))


def wrong_reciprocity() -> AbstractContextManager[None]:
    from sarmitsuba.tracing.kernel.scattering_matrix import ScatteringMatrix

    # of every two calls the second asks for the reversed path: it returns nothing
    def make(f: Any) -> Any:
        def between(self: Any, q: Any, e: Any) -> Any:
            values = f(self, q, e)
            if not (self.flags.diffuse_double and self.flags.multi_bounce) or getattr(self, "retro", False):
                return values
            self.calls = getattr(self, "calls", 0) + 1
            return values if self.calls % 2 else [v * 0.0 for v in values]

        return between

    def retro(f: Any) -> Any:
        def between_fields(self: Any, q: Any, e: Any) -> Any:
            self.retro = True
            try:
                return f(self, q, e)
            finally:
                self.retro = False

        return between_fields

    return _all(
        _replaced(ScatteringMatrix, "between", make), _replaced(ScatteringMatrix, "between_fields", retro)
    )


def missing_cosine() -> AbstractContextManager[None]:
    from sarmitsuba.tracing.kernel import kernel

    # dS = dOmega L^2 instead of dOmega L^2 / cos
    def make(f: Any) -> Any:
        def footprint(k: Any, lane: Any, ray: Any, hit: Any) -> Any:
            tube_here = f(k, lane, ray, hit)
            return replace(tube_here, area=tube_here.area * hit.cos_incidence)

        return footprint

    return _replaced(kernel, "footprint", make)


def no_tube_phase() -> AbstractContextManager[None]:
    from sarmitsuba.tracing.kernel.tubes import polygon

    return _replaced(
        polygon,
        "phase_integral",
        lambda f: (
            lambda q, u, v, bounds, longest, kept_up_to, of_part: (
                mi.Complex2f(bounds.area(), 0.0),
                mi.Float(0.0),
                mi.Float(0.0),
            )
        ),
    )


def swapped_fresnel() -> AbstractContextManager[None]:
    from sarmitsuba.tracing.kernel import field

    return _replaced(field, "fresnel", lambda f: lambda *a: tuple(reversed(f(*a))))


def wrong_reflection_sign() -> AbstractContextManager[None]:
    from sarmitsuba.tracing.kernel import field

    # E -> -E, the part along the normal turned round with the rest: the dihedral loses its HH - VV phase
    def make(f: Any) -> Any:
        return lambda e, n: (-e[0], -e[1])

    return _replaced(field, "reflect_field_pec", make)


def lambert_without_cosine() -> AbstractContextManager[None]:
    from sarmitsuba.scene.materials import diffuse
    from sarmitsuba.scene.materials.laws.constant import ConstantGamma, Lambert

    # tables that unharmed cases have cached would hide it
    return _all(
        _replaced(Lambert, "sigma0", lambda f: ConstantGamma.sigma0),
        _replaced(diffuse, "_sigma0", lambda f: f.__wrapped__),
    )


def forgotten_loss() -> AbstractContextManager[None]:
    from sarmitsuba.radar.radar import Radar

    def make(f: Any) -> Any:
        return property(lambda self: f.fget(self) * np.sqrt(self.losses))

    return _replaced(Radar, "amplitude_constant", make)


@contextmanager
def _all(*contexts: AbstractContextManager[None]) -> Iterator[None]:
    from contextlib import ExitStack

    with ExitStack() as stack:
        for context in contexts:
            stack.enter_context(context)
        yield


# error -> how to plant it, cases that look at that physics
PLANTED: dict[str, tuple[Callable[[], AbstractContextManager[None]], tuple[str, ...]]] = {
    "dropped factor 2 (PO current)": (dropped_factor_two, ("plate", "corner_peaks")),
    "flipped phase sign": (flipped_phase_sign, ("plate", "dihedral", "traced_rcs")),
    "one-way phase": (one_way_phase, ("plate",)),
    "float32 path lengths": (float32_phase, ("plate", "traced_rcs")),
    "wrong reciprocity (reversed path left out)": (wrong_reciprocity, ("canonical_building",)),
    "missing 1 / cos (tube footprint)": (missing_cosine, ("plate", "dihedral")),
    "missing cos (Lambert's law)": (lambert_without_cosine, ("diffuse_level",)),
    "no phase integral over the tube": (no_tube_phase, ("plate", "sphere")),
    "TE and TM swapped": (swapped_fresnel, ("fresnel_kernel", "wall_ground")),
    "sign of the reflected field": (wrong_reflection_sign, ("dihedral", "rolled_dihedral")),
    "losses left out of the radar equation": (forgotten_loss, ("received_power",)),
}


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "--only", nargs="+", metavar="WORD", help="errors whose name holds one of these words"
    )
    args = parser.parse_args()
    warnings.simplefilter("ignore", SarmitsubaWarning)
    ensure_backend()
    planted = {
        name: entry
        for name, entry in PLANTED.items()
        if not args.only or any(word in name for word in args.only)
    }
    bad = 0
    for case in sorted({c for _, cases in planted.values() for c in cases}):
        result = run_case(CASES[case], quick=True)
        if not result.passed:
            bad += 1
            print(f"unharmed: {result.failures()}")
    print(
        "unharmed: every case within its tolerance" if not bad else f"unharmed: {bad} cases out of tolerance"
    )
    print("\n| planted error | caught by (worst deviation, tolerance) | not seen by |\n|---|---|---|")
    for name, (plant, cases) in planted.items():
        caught, missed = [], []
        for case in cases:
            with plant():
                result = run_case(CASES[case], quick=True)
            failed = [c for c in result.comparisons if not c.passed]
            if failed:
                worst = max(failed, key=lambda c: c.worst / c.tolerance)
                caught.append(
                    f"{case} [{worst.label}] ({worst.worst:.3g}, {worst.tolerance:.2g} {worst.unit})"
                )
            else:
                missed.append(case)
        bad += not caught
        print(f"| {name} | {'; '.join(caught) or '**nothing**'} | {', '.join(missed) or '-'} |", flush=True)
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
