"""Coarse start of shapes: values moved by the offsets of the shapes' echoes, over wavelengths and range cells."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from sarmitsuba.apps.fit.confirmation import coherences, least
from sarmitsuba.apps.fit.measured_looks import MeasuredLook
from sarmitsuba.apps.fit.shape_offsets import (
    MovingPart,
    Offset,
    echoes,
    moving_parts,
    offset,
    track_direction,
)
from sarmitsuba.core.arrays import F64

# rounds of offsets at most, and cells of range and azimuth that each looks at
ROUNDS = (12.0, 2.0, 1.0, 1.0, 1.0, 1.0)
# power of a correlation's peak over the mean elsewhere from which it counts: among 1e5 places one in 1e4 is higher
LEAST_PEAK = 10.0
# the same for parts whose points move unequally, which are themselves blurred
LEAST_UNEVEN_PEAK = 50.0
# share of the echoes that data and model have in common from which a shape counts as within its cycle of phase
IN_PHASE = 0.5
# offset below which a round was the last, wavelengths
SETTLED = 1.0 / 32.0
# drawn combinations of cycles of phase
DRAWS = 400
# standard deviation of the carrier's phase at least, as a length in wavelengths: other shapes' echoes that are off
LEAST_CYCLE = 1.0 / 60.0
# changes by other cycles of phase that are tried at most at a time, and how often
TRIED, RETRIES = 40, 6
# rms deviation of the points of a part from its velocity, over that, up to which a value displaces it alike
EVEN = 0.2
# sum of squares above the least from which changes are not tried: five standard deviations
UNLIKELY = 25.0
# share of confirmed echoes from which no other cycles are tried, and by which another one must be better
SURE, BETTER = 0.97, 0.02
# how often equations of parts whose points move unequally are weighed again by the changes found
WEIGHED = 3


@dataclass(frozen=True, eq=False)
class OffsetEquation:
    """Equation for changes of values: their products with ``factor`` add up to ``offset``, but for whole periods.

    Parameters
    ----------
    factor : (n_values,) m per unit
    offset, sigma : m
    uneven : (n_values,) m per unit, by which points deviate from ``factor``
    period : m; 0: unambiguous
    """

    factor: F64
    offset: float
    sigma: float
    uneven: F64
    period: float = 0.0

    def after(self, change: F64) -> OffsetEquation:
        """The same, less sure by the deviations of points with these changes of the values."""
        return replace(self, sigma=float(np.hypot(self.sigma, np.linalg.norm(self.uneven * change))))


@dataclass(frozen=True, eq=False)
class Measured:
    """Offset of a part of a shape in one look."""

    look: MeasuredLook
    part: MovingPart
    found: Offset

    def rows(self, in_phase: bool, carrier: bool) -> list[OffsetEquation]:
        """Equations for the values.

        Parameters
        ----------
        in_phase : the shape is within its cycle of phase: of the range only the carrier counts, without ambiguity
        carrier : whether the phase of the carrier counts beside the envelope
        """
        part, found = self.part, self.found
        wavelength = self.look.model.scene.radar.waveform.wavelength
        fine = max(wavelength / (4.0 * np.pi * np.sqrt(2.0 * found.peak)), LEAST_CYCLE * wavelength)
        rows = (
            [OffsetEquation(part.factor, found.unmoved, fine, part.uneven)] if in_phase and part.alike else []
        )
        if found.peak < (LEAST_PEAK if part.alike else LEAST_UNEVEN_PEAK):
            return rows
        # the carrier alone would move along the track, by metres, what it says of the range
        if np.isfinite(found.azimuth) and (part.alike or not in_phase):
            along = -part.velocity @ track_direction(self.look.model.scene.radar, part)
            rows.append(OffsetEquation(np.asarray(along), found.azimuth, found.sigma[1], part.uneven))
        if in_phase:
            return rows
        rows.append(OffsetEquation(part.factor, found.range, found.sigma[0], part.uneven))
        if carrier:
            rows.append(OffsetEquation(part.factor, found.carrier, fine, part.uneven, 0.5 * wavelength))
        return rows


def coarse_shapes(
    looks: Sequence[MeasuredLook], start: F64, passed: Callable[[F64], None] | None = None
) -> tuple[F64, F64]:
    """Values with those that displace shapes moved by the offsets of their echoes, and standard deviations.

    Shapes whose echoes are in phase with the data at the start stay within their cycle at first. In the end, shapes
    whose echoes the data do not confirm try the cycles beside theirs. The standard deviation is that of the offsets'
    envelopes, before the phase of the carrier sharpens them: infinite for values that nothing was found of, NaN for
    those that displace no shape. ``passed`` : called with the values after every round.
    """
    values, spread = np.array(start), np.full(len(start), np.nan)
    in_phase: set[int] = set()
    for number, reach in enumerate(ROUNDS):
        found = [one for look in looks for one in measured_offsets(look, values, reach)]
        if not found:
            return values, spread
        if number == 0:
            in_phase = {mesh for mesh in meshes(found) if share_in_phase(found, mesh) > IN_PHASE}
        elif number > 1:  # the envelopes tell now whether it is the right cycle
            in_phase = set()
        change, farthest = np.zeros(len(values)), 0.0
        for mesh in meshes(found):
            moved, rows = equations(found, mesh, mesh in in_phase, number > 0)
            if not len(moved):
                continue
            steps, spread[moved] = solutions(rows, moved)
            steps = [step for step in steps if _possible(looks, values, moved, step)]
            change[moved] = steps[0] if steps else 0.0
            farthest = max([farthest, *(abs(float(row.factor @ change)) for row in rows)])
        values = values + change
        if passed is not None:
            passed(values)
        if farthest < SETTLED * looks[0].model.scene.radar.waveform.wavelength:
            break
    return other_cycles(looks, values), spread


def checked_offsets(looks: Sequence[MeasuredLook], values: F64) -> tuple[F64, F64]:
    """Values with shapes moved to other cycles of phase where the envelopes of their echoes say so, and deviations.

    Where the shapes are nearly in place their echoes tell it better than at first.
    """
    found = [one for look in looks for one in measured_offsets(look, values, ROUNDS[-1])]
    changed, spread = np.array(values), np.full(len(values), np.nan)
    for mesh in meshes(found):
        moved, rows = equations(found, mesh, False, True)
        if not len(moved):
            continue
        steps, spread[moved] = solutions(rows, moved)
        step = np.zeros(len(values))
        step[moved] = steps[0]
        cycle = 0.25 * looks[0].model.scene.radar.waveform.wavelength
        if max((abs(float(row.factor @ step)) for row in rows), default=0.0) > cycle and _possible(
            looks, values, moved, steps[0]
        ):
            changed = changed + step
    return changed, spread


def other_cycles(looks: Sequence[MeasuredLook], values: F64) -> F64:
    """Values of shapes that the data do not confirm with the cycles of phase that they confirm most."""
    share = _coherent(looks, values)
    for _ in range(RETRIES):
        doubtful = np.flatnonzero(share < SURE)
        if not len(doubtful):
            break
        found = [one for look in looks for one in measured_offsets(look, values, ROUNDS[1], doubtful)]
        others = []
        for mesh in meshes(found):
            moved, rows = equations(found, mesh, False, True)
            if not len(moved):
                continue
            steps = [s for s in solutions(rows, moved)[0] if _possible(looks, values, moved, s)]
            if steps:
                others.append((moved, steps))
        best, better = np.array(values), False
        for k in range(max((len(steps) for _, steps in others), default=0)):
            tried = np.array(values)
            for moved, steps in others:
                tried[moved] += steps[min(k, len(steps) - 1)]
            new = _coherent(looks, tried, doubtful)
            for moved, _ in others:
                if (new[moved] > share[moved] + BETTER).all():
                    best[moved], share[moved], better = tried[moved], new[moved], True
        if not better:
            break
        values = best
    return values


def _coherent(looks: Sequence[MeasuredLook], values: F64, numbers: NDArray[np.intp] | None = None) -> F64:
    """(n_values,) least coherence of the shapes that each value moves; NaN for values that move none."""
    found, moves = coherences(looks, values, numbers)
    return least(((moves[mesh], one.coherence) for mesh, one in found.items()), len(values))


def _possible(looks: Sequence[MeasuredLook], values: F64, moved: NDArray[np.intp], step: F64) -> bool:
    """Whether the scene can have changed values."""
    tried = np.array(values)
    tried[moved] += step
    return looks[0].model.possible(tried)


def meshes(found: Sequence[Measured]) -> list[int]:
    """Numbers of the shapes of some offsets."""
    return sorted({one.part.mesh for one in found})


def equations(
    found: Sequence[Measured], mesh: int, in_phase: bool, carrier: bool
) -> tuple[NDArray[np.intp], list[OffsetEquation]]:
    """Numbers of the values that displace some part of a shape alike, and equations, see :meth:`Measured.rows`."""
    own = [one for one in found if one.part.mesh == mesh]
    rows = [row for one in own for row in one.rows(in_phase, carrier)]
    speed = np.linalg.norm([one.part.velocity for one in own], axis=2)
    alike = (speed > 0.0) & (np.array([one.part.uneven for one in own]) <= EVEN * speed)
    return np.flatnonzero(alike.any(axis=0)), rows


def measured_offsets(
    look: MeasuredLook, values: F64, reach: float, numbers: NDArray[np.intp] | None = None
) -> list[Measured]:
    """Offsets of all parts of a look, from the data that the model leaves unexplained where it explains some of them.

    ``numbers`` : only of parts that one of these values moves
    """
    model = look.model
    parts = _pick_values(moving_parts(model, values), numbers)
    if not parts:
        return []
    modelled, spectra = echoes(model, values, parts)
    left = look.measured - modelled
    explains = np.linalg.norm(left) < np.linalg.norm(look.measured)
    data = np.fft.fft(left if explains else look.measured, axis=-1)
    found = []
    for part, own in zip(parts, spectra, strict=True):
        one = offset(model, part, data + own if explains else data, own, reach)
        if one is not None:
            found.append(Measured(look, part, one))
    return found


def _pick_values(parts: list[MovingPart], numbers: NDArray[np.intp] | None) -> list[MovingPart]:
    return parts if numbers is None else [part for part in parts if part.moves[numbers].any()]


def share_in_phase(found: Sequence[Measured], mesh: int) -> float:
    """Share of the echoes of a shape that data and model have in common, in phase, over all looks."""
    own = [one.found for one in found if one.part.mesh == mesh]
    return sum(one.share * one.energy for one in own) / sum(one.energy for one in own)


def solutions(rows: Sequence[OffsetEquation], numbers: NDArray[np.intp]) -> tuple[list[F64], F64]:
    """Changes of some values, the likeliest first, and standard deviations from the unambiguous equations.

    The changes differ in the cycles of phase: those nearest to drawn changes, which spread as the unambiguous equations
    say; by the least sum of squares, each weighed by the unequal motion of the parts that its change makes.
    """
    if all(row.period for row in rows):
        return [np.zeros(len(numbers))], np.full(len(numbers), np.inf)
    first = np.zeros(len(numbers))
    change = np.zeros(len(rows[0].factor))
    for _ in range(WEIGHED):
        change[numbers] = first
        clear = [row.after(change) for row in rows if not row.period]
        matrix, right = _weigh_equations(clear, numbers)
        inverse = np.linalg.pinv(matrix, rcond=1e-6)
        first, covariance = inverse @ right, inverse @ inverse.T
    sigma = np.sqrt(np.diag(covariance))
    sigma[np.diag(inverse @ matrix) < 0.5] = np.inf
    cyclic = [row.after(change) for row in rows if row.period]
    if not cyclic:
        return [first], sigma
    draws = np.random.default_rng(0).multivariate_normal(first, covariance, DRAWS, method="eigh")
    seen: dict[tuple[int, ...], tuple[float, F64]] = {}
    for drawn in [first, *draws]:
        cycles = tuple(
            round((float(row.factor[numbers] @ drawn) - row.offset) / row.period) for row in cyclic
        )
        if cycles not in seen:
            seen[cycles] = _solve_changes(rows, numbers, cycles, drawn)
    ordered = sorted(seen.values(), key=lambda one: one[0])[:TRIED]
    return [solved for square, solved in ordered if square < ordered[0][0] + UNLIKELY], sigma


def _solve_changes(
    rows: Sequence[OffsetEquation], numbers: NDArray[np.intp], cycles: Sequence[int], near: F64
) -> tuple[float, F64]:
    """Twice minus the log likelihood of changes of some values with given cycles, and these changes.

    ``near`` : changes by which unequally moved parts are weighed at first
    """
    cyclic = iter(cycles)
    unwrapped = [
        replace(row, offset=row.offset + next(cyclic) * row.period) if row.period else row for row in rows
    ]
    change, solved = np.zeros(len(rows[0].factor)), near
    for _ in range(WEIGHED):
        change[numbers] = solved
        weighed = [row.after(change) for row in unwrapped]
        matrix, right = _weigh_equations(weighed, numbers)
        solved = np.asarray(np.linalg.lstsq(matrix, right, rcond=1e-6)[0], dtype=np.float64)
    spread = 2.0 * sum(float(np.log(row.sigma)) for row in weighed)
    return float(np.sum((matrix @ solved - right) ** 2)) + spread, solved


def _weigh_equations(rows: Sequence[OffsetEquation], numbers: NDArray[np.intp]) -> tuple[F64, F64]:
    """Matrix and right side of equations over their standard deviations."""
    matrix = np.array([row.factor[numbers] / row.sigma for row in rows])
    return matrix, np.array([row.offset / row.sigma for row in rows])
