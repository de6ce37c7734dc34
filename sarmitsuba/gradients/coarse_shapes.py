"""Coarse start of shapes: values moved by the offsets of the shapes' echoes, many wavelengths and range cells if need be."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from sarmitsuba.arrays import F64
from sarmitsuba.gradients.looks import Look
from sarmitsuba.gradients.shape_offsets import (
    Offset,
    Part,
    echoes,
    moving_parts,
    offset,
    track_direction,
)

# rounds of offsets at most, and cells of range and azimuth that each looks at
ROUNDS = (12.0, 2.0, 1.0, 1.0, 1.0)
# power of a correlation's peak over the mean elsewhere from which it counts: among 1e5 places one in 1e4 is higher
LEAST_PEAK = 20.0
# share of the echoes that data and model have in common from which a shape counts as within its cycle of phase
IN_PHASE = 0.5
# offset below which a round was the last, wavelengths
SETTLED = 1.0 / 32.0
# drawn combinations of cycles of phase
DRAWS = 400
# standard deviation of the carrier's phase at least, as a length in wavelengths: other shapes' echoes that are off
LEAST_CYCLE = 1.0 / 60.0
# weight of parts whose points move differently, by their standard deviation
UNEQUAL = 4.0


@dataclass(frozen=True, eq=False)
class Row:
    """Equation for changes of values: their products with ``factor`` add up to ``offset``, but for whole periods.

    Parameters
    ----------
    factor : (n_values,) m per unit
    offset, sigma : m
    period : m; 0: unambiguous
    """

    factor: F64
    offset: float
    sigma: float
    period: float = 0.0


@dataclass(frozen=True, eq=False)
class Measured:
    """Offset of a part of a shape in one look."""

    look: Look
    part: Part
    found: Offset

    def rows(self, in_phase: bool, carrier: bool) -> list[Row]:
        """Equations for the values.

        Parameters
        ----------
        in_phase : the shape is within its cycle of phase: only the carrier counts, without ambiguity
        carrier : whether the phase of the carrier counts beside the envelope
        """
        part, found = self.part, self.found
        wavelength = self.look.model.scene.radar.waveform.wavelength
        fine = max(wavelength / (4.0 * np.pi * np.sqrt(2.0 * found.peak)), LEAST_CYCLE * wavelength)
        if in_phase:
            return [Row(part.factor, found.unmoved, fine)] if part.alike else []
        if found.peak < LEAST_PEAK:
            return []
        less = 1.0 if part.alike else UNEQUAL
        rows = [Row(part.factor, found.range, less * found.sigma[0])]
        if np.isfinite(found.azimuth):
            along = -part.velocity @ track_direction(self.look.model.scene.radar, part)
            rows.append(Row(np.asarray(along), found.azimuth, less * found.sigma[1]))
        if carrier and part.alike:
            rows.append(Row(part.factor, found.carrier, fine, 0.5 * wavelength))
        return rows


def coarse_shapes(looks: Sequence[Look], start: F64) -> tuple[F64, F64]:
    """Values with those that displace shapes moved by the offsets of their echoes, and standard deviations.

    Shapes whose echoes are in phase with the data at the start stay within their cycle. The standard deviation is that
    of the offsets' envelopes, before the phase of the carrier sharpens them: infinite for values that nothing was found
    of, 0 for those of shapes in phase, NaN for those that displace no shape.
    """
    values, spread = np.array(start), np.full(len(start), np.nan)
    in_phase: set[int] = set()
    for number, reach in enumerate(ROUNDS):
        found = [one for look in looks for one in measured_offsets(look, values, reach)]
        meshes = sorted({one.part.mesh for one in found})
        if number == 0:
            in_phase = {m for m in meshes if shared(found, m) > IN_PHASE}
        change, farthest = np.zeros(len(values)), 0.0
        for mesh in meshes:
            own = [one for one in found if one.part.mesh == mesh]
            rows = [row for one in own for row in one.rows(mesh in in_phase, number > 0)]
            moved = np.flatnonzero(np.abs([one.part.velocity for one in own]).max(axis=(0, 2)))
            step, sigma = _solved(rows, moved)
            change[moved], spread[moved] = step, 0.0 if mesh in in_phase else sigma
            farthest = max([farthest, *(abs(float(row.factor @ change)) for row in rows)])
        values += change
        if farthest < SETTLED * looks[0].model.scene.radar.waveform.wavelength:
            break
    return values, spread


def measured_offsets(look: Look, values: F64, reach: float) -> list[Measured]:
    """Offsets of all parts of a look, from what the model leaves of the data where it explains some of them."""
    model = look.model
    parts = moving_parts(model, values)
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


def shared(found: Sequence[Measured], mesh: int) -> float:
    """Share of the echoes of a shape that data and model have in common, in phase, over all looks."""
    own = [one.found for one in found if one.part.mesh == mesh]
    return sum(one.share * one.energy for one in own) / sum(one.energy for one in own)


def _solved(rows: Sequence[Row], numbers: NDArray[np.intp]) -> tuple[F64, F64]:
    """Changes of some values and standard deviations of the envelopes' part.

    The cycles of phase are those of the drawn changes, spread as the envelopes say, with the least sum of squares.
    """
    clear = [row for row in rows if not row.period]
    if not clear:
        return np.zeros(len(numbers)), np.full(len(numbers), np.inf)
    matrix, right = _weighed(clear, numbers)
    inverse = np.linalg.pinv(matrix, rcond=1e-6)
    first, covariance = inverse @ right, inverse @ inverse.T
    sigma = np.sqrt(np.diag(covariance))
    sigma[np.diag(inverse @ matrix) < 0.5] = np.inf
    cyclic = [row for row in rows if row.period]
    if not cyclic:
        return first, sigma
    draws = np.random.default_rng(0).multivariate_normal(first, covariance, DRAWS, method="eigh")
    best, least = first, np.inf
    for drawn in [first, *draws]:
        unwrapped = []
        for row in cyclic:
            cycles = np.round((float(row.factor[numbers] @ drawn) - row.offset) / row.period)
            unwrapped.append(replace(row, offset=row.offset + float(cycles) * row.period))
        matrix, right = _weighed([*clear, *unwrapped], numbers)
        solved = np.linalg.lstsq(matrix, right, rcond=1e-6)[0]
        square = float(np.sum((matrix @ solved - right) ** 2))
        if square < least:
            best, least = solved, square
    return best, sigma


def _weighed(rows: Sequence[Row], numbers: NDArray[np.intp]) -> tuple[F64, F64]:
    """Matrix and right side of equations over their standard deviations."""
    matrix = np.array([row.factor[numbers] / row.sigma for row in rows])
    return matrix, np.array([row.offset / row.sigma for row in rows])


def confirmed(looks: Sequence[Look], values: F64) -> F64:
    """(n_values,) share of the echoes of the shape that each value moves which data and model have in common, in phase.

    1 where model and data are alike, less where they are off by cycles of phase, as only part of the shape's echoes
    agree then; NaN for values that move no shape.
    """
    both, alone = np.zeros(len(values)), np.zeros(len(values))
    for look in looks:
        parts = moving_parts(look.model, values, whole=True)
        if not parts:
            continue
        modelled, spectra = echoes(look.model, values, parts)
        left = np.fft.fft((look.measured - modelled).astype(np.complex128), axis=-1)
        for part, own in zip(parts, spectra, strict=True):
            energy = float(np.sum(np.abs(own) ** 2)) / look.noise.variance(left / np.sqrt(left.shape[-1]))
            if energy > 0.0:
                share = 1.0 + float(np.vdot(own, left).real / np.sum(np.abs(own) ** 2))
                moved = part.velocity.any(axis=1)
                both[moved] += energy * share
                alone[moved] += energy
    return np.where(alone > 0.0, both / np.where(alone > 0.0, alone, 1.0), np.nan)
