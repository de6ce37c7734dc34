r"""Other cycles of phase that a fit may have missed: how likely they are beside the one it found.

The offsets of a shape's parts between data and model leave some cycles open, see
:func:`sarmitsuba.apps.fit.coarse_shapes.solutions`; and whatever they say, the cycles beside the one found are looked
at: half wavelengths along each line of sight, and their combinations. For each the raw data are traced anew, and with
the data d less all other echoes and the shape's echoes m its log likelihood with unknown amplitude, phase in each look,
and place along the track exceeds that of no echo by

.. math:: A = \Big(\sum |\langle m, d \rangle| / \sigma^2\Big)^2 \Big/ \sum |m|^2 / \sigma^2

which is at least the likelihood left after the values are fitted there; of the cycle that was found the real part
counts. The probability of the latter is one over the sum of all :math:`e^{A_k - A_0}`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from sarmitsuba.apps.fit.coarse_shapes import (
    ROUNDS,
    Measured,
    OffsetEquation,
    equations,
    measured_offsets,
    meshes,
    solutions,
)
from sarmitsuba.apps.fit.coarse_track import track_cycles
from sarmitsuba.apps.fit.least_squares import Prior
from sarmitsuba.apps.fit.measured_looks import MeasuredLook
from sarmitsuba.apps.fit.shape_offsets import MovingPart, echoes, moving_parts, track_direction
from sarmitsuba.core.arrays import C64, C128, F64, sum_energy, unit_rows

# least displacement of a part that makes another cycle, in periods
ANOTHER = 0.5
# log of the ratio of likelihoods below which a cycle is out of the question: one in 1e5 is another by chance
OUT = -12.0
# share of the log likelihood of the cycle found by which another may be less likely before its values are fitted: what
# is traced at whole cycles along the lines of sight is off by the values that are not of them
UNFITTED = 0.3
# least change of a track that is another cycle, m, and its number in place of a mesh's
LEAST_STEP, NO_MESH = 1e-3, -1
# cycles of a shape that are looked at by the offsets of its parts, and beside the one found in one look
MOST, NEIGHBOURS = 24, 2
# places along the track that are looked at within an azimuth cell, and cells to either side
FINE, CELLS = 8, 1


@dataclass(frozen=True, eq=False)
class Rival:
    """Another cycle of a shape.

    Parameters
    ----------
    mesh : number of the shape; ``NO_MESH``: the antenna's track
    moved : numbers of the values that differ
    values : (n_values,) all of them
    advantage : most by which its log likelihood exceeds that of the cycle found
    """

    mesh: int
    moved: NDArray[np.intp]
    values: F64
    advantage: float


def rival_cycles(looks: Sequence[MeasuredLook], values: F64, known: Mapping[int, Prior]) -> list[Rival]:
    """Other cycles that values fitted there may make as likely, the likeliest first; ``known``: priors by number."""
    found = [one for look in looks for one in measured_offsets(look, values, ROUNDS[-1])]
    rivals = []
    for mesh in meshes(found):
        moved, rows = equations(found, mesh, False, True)
        if not len(moved):
            continue
        steps = [step for step in solutions(rows, moved)[0] if _another(rows, moved, step)][:MOST]
        # cycles of two looks that no change of the values joins leave the parts where they are
        beside = [step for step in _neighbours(found, mesh, moved) if _another(rows, moved, step)]
        steps += [step for step in beside if not _near(rows, moved, step, steps)]
        tried = [_step_values(values, moved, step) for step in steps]
        tried = [one for one in tried if looks[0].model.possible(one)]
        if tried:
            shape = _Likelihood.of_shape(looks, values, mesh)
            found_here = [
                Rival(mesh, moved, one, shape.advantage([look.model.data(one) for look in looks]))
                for one in tried
            ]
            rivals += [rival for rival in found_here if rival.advantage > OUT - UNFITTED * shape.best]
    if len(looks) == 1:
        rivals += [rival for rival in _find_track_cycles(looks[0], values, known) if rival.advantage > OUT]
    return sorted(rivals, key=lambda r: -r.advantage)


def _find_track_cycles(look: MeasuredLook, values: F64, known: Mapping[int, Prior]) -> list[Rival]:
    """Other cycles of the antenna's track, which all echoes share."""
    tried = track_cycles(look.model, look.measured, values, known)
    tried = [one for one in tried if np.abs(one - values).max() > LEAST_STEP]
    if not tried:
        return []
    modelled = look.model.data(values).astype(np.complex128)
    measured = look.measured.astype(np.complex128)
    everything = _Likelihood([np.zeros_like(modelled)], [measured], [modelled], [look])
    return [
        Rival(NO_MESH, np.flatnonzero(one != values), one, everything.advantage([look.model.data(one)]))
        for one in tried
    ]


def likely(rivals: Sequence[Rival], n_values: int) -> F64:
    """(n_values,) probability that the shape which each value moves is at the cycle found; 1 without rivals."""
    others = np.zeros(n_values)
    for rival in rivals:
        others[rival.moved] += np.exp(min(rival.advantage, 100.0))
    return np.asarray(1.0 / (1.0 + others))


def _another(rows: Sequence[OffsetEquation], moved: NDArray[np.intp], step: F64) -> bool:
    """Whether changes of some values displace a part by half a cycle or more."""
    return any(row.period and abs(float(row.factor[moved] @ step)) > ANOTHER * row.period for row in rows)


def _near(rows: Sequence[OffsetEquation], moved: NDArray[np.intp], step: F64, others: Sequence[F64]) -> bool:
    """Whether changes of some values are at the cycle of one of others."""
    return any(not _another(rows, moved, step - other) for other in others)


def _neighbours(found: Sequence[Measured], mesh: int, moved: NDArray[np.intp]) -> list[F64]:
    """Least changes of some values by which a shape's echoes are whole cycles farther or nearer, in all combinations.

    Of one look by up to two cycles, of several by up to one in each of the first two, which decide a place on a plane.
    """
    factors, period = list[F64](), 0.0
    for one in found:
        factor = one.part.factor[moved]
        if one.part.mesh == mesh and one.part.alike and factor.any():
            period = 0.5 * one.look.model.scene.radar.waveform.wavelength
            factors.append(factor)
    factors = factors[:2]
    reach = NEIGHBOURS if len(factors) == 1 else 1
    steps = []
    for cycles in product(range(-reach, reach + 1), repeat=len(factors)):
        if any(cycles):
            step = np.linalg.lstsq(np.array(factors), period * np.array(cycles), rcond=1e-6)[0]
            steps.append(np.asarray(step, dtype=np.float64))
    return steps


def _step_values(values: F64, moved: NDArray[np.intp], step: F64) -> F64:
    changed = np.array(values)
    changed[moved] += step
    return changed


class _Likelihood:
    """Echoes of a shape, or all: the likelihood that the data less all others hold them.

    Parameters
    ----------
    others, data, own : of each look: echoes of all others, data less these, and the echoes as they were found
    looks : with their noise
    turns : of each look, (n, n_pulses) factors of its pulses by places along the track; None: the place it is at
    """

    def __init__(
        self,
        others: Sequence[C128],
        data: Sequence[C128],
        own: Sequence[C128],
        looks: Sequence[MeasuredLook],
        turns: Sequence[C128] | None = None,
    ) -> None:
        self.others, self.data, self.turns = others, data, turns
        left = [(d - m).astype(np.complex128) for d, m in zip(data, own, strict=True)]
        self.variances = [look.noise.variance(one) for look, one in zip(looks, left, strict=True)]
        self.best = self._gain(own, modulus=False)

    @staticmethod
    def of_shape(looks: Sequence[MeasuredLook], values: F64, mesh: int) -> _Likelihood:
        """Those of a shape at some values."""
        others, data, own, turns = [], [], [], []
        for look in looks:
            (part,) = [p for p in moving_parts(look.model, values, whole=True) if p.mesh == mesh]
            modelled, (spectrum,) = echoes(look.model, values, [part])
            own.append(np.fft.ifft(spectrum, axis=-1))
            others.append(modelled - own[-1])
            data.append(look.measured - others[-1])
            turns.append(_turns(look, part))
        return _Likelihood(others, data, own, looks, turns)

    def advantage(self, modelled: Sequence[C64]) -> float:
        """See :class:`Rival`; ``modelled``: raw data of each look at other values."""
        own = [one - others for one, others in zip(modelled, self.others, strict=True)]
        return self._gain(own, modulus=True) - self.best

    def _gain(self, own: Sequence[C128], *, modulus: bool) -> float:
        """A of the module from the echoes in each look."""
        products = [np.sum(m.conj() * d, axis=(0, 2)) for m, d in zip(own, self.data, strict=True)]
        turns = self.turns or [np.ones((1, len(x)), dtype=np.complex128) for x in products]
        parts = [
            float(np.abs(turn @ x).max() if modulus else x.sum().real)
            for x, turn in zip(products, turns, strict=True)
        ]
        both = sum(x / v for x, v in zip(parts, self.variances, strict=True))
        energy = sum(sum_energy(m) / v for m, v in zip(own, self.variances, strict=True))
        return float(max(both, 0.0) ** 2 / energy) if energy > 0.0 else 0.0


def _turns(look: MeasuredLook, part: MovingPart) -> C128:
    """Factors (n, n_pulses) by which a part's echoes turn from pulse to pulse at places along the track."""
    radar = look.model.scene.radar
    away = radar.track.position - part.center
    away = unit_rows(away)
    along = (away - part.towards) @ track_direction(radar, part)
    wide = float(np.ptp(along))
    if not wide > 0.0:
        return np.ones((1, len(along)), dtype=np.complex128)
    cell = radar.waveform.wavelength / (2.0 * wide)
    places = np.arange(-CELLS * FINE, CELLS * FINE + 1) * cell / FINE
    return np.asarray(np.exp(4j * np.pi / radar.waveform.wavelength * np.outer(places, along)))
