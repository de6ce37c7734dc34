r"""Coarse start of scales and rotations, whose points move unequally: a search along each value.

Where points are off by unequal parts of a wavelength or more, the echoes of a shape do not correlate with the data,
wherever they are moved to. So each value is stepped so that its points are displaced by an eighth of a wavelength
against each other, the raw data are traced anew at every step, and with the spectra D of the data less all other echoes
and M of the shape's the score of a step,

.. math:: \sum \max_{r, s} |C(r, s)|^2 / (\sigma^2 E), \quad C = \sum_{p, f} D \, M^* \, e^{j k (r + s a_p)}

over all looks is that of its likelihood with an unknown amplitude, phase and place, E the energy of M.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from sarmitsuba.apps.fit.confirmation import CONFIRMED, coherences
from sarmitsuba.apps.fit.measured_looks import MeasuredLook
from sarmitsuba.apps.fit.shape_offsets import MovingPart, echoes, moving_parts, velocities
from sarmitsuba.apps.fit.shape_parameters import Deformation
from sarmitsuba.core.arrays import C128, F64, sum_energy

# steps of a search to either side, of a displacement of points against each other by a share of a wavelength
STEPS, STEP = 64, 1.0 / 8.0
# halvings of the step about the best one
FINER = 2
# lags of the correlation that are looked at, in samples of range and pulses' frequencies; finer than these
LAGS, FINE = 16, 2
# kinds of deformations that move points unequally
SEARCHED = ("scale", "rotation")


def searched_forms(
    looks: Sequence[MeasuredLook], start: F64, passed: Callable[[F64], None] | None = None
) -> F64:
    """Values with the scales and rotations of shapes that the data do not confirm searched for.

    ``passed`` : called with the values after every search
    """
    model, values = looks[0].model, np.array(start)
    kinds = [
        p.kind if isinstance(p, Deformation) else "" for p in model.parameters for _ in p.names(model.scene)
    ]
    numbers = np.flatnonzero(np.isin(kinds, SEARCHED))
    if not len(numbers):
        return values
    found, moves = coherences(looks, values, numbers)
    for number in numbers:
        mesh = next((mesh for mesh, own in moves.items() if own[number]), None)
        if mesh is None or not found[mesh].coherence < CONFIRMED:
            continue
        values = _Search(looks, values, int(number), mesh).best()
        if passed is not None:
            passed(values)
    return values


class _Search:
    """Search along one value.

    Parameters
    ----------
    looks : with data
    values : where it starts
    number, mesh : of the value, and of the shape that it moves
    """

    def __init__(self, looks: Sequence[MeasuredLook], values: F64, number: int, mesh: int) -> None:
        self.looks, self.values, self.number = looks, values, number
        self.step = np.inf
        self.others: list[C128] = []
        self.data: list[C128] = []
        for look in looks:
            model = look.model
            (part,) = [p for p in moving_parts(model, values, whole=True) if p.mesh == mesh]
            modelled, (own,) = echoes(model, values, [part])
            self.others.append(np.fft.fft(modelled.astype(np.complex128), axis=-1) - own)
            self.data.append(np.fft.fft(look.measured.astype(np.complex128), axis=-1) - self.others[-1])
            wavelength = model.scene.radar.waveform.wavelength
            self.step = min(self.step, STEP * wavelength / _apart(look, values, number, part))

    def best(self) -> F64:
        """Values with the best one."""
        offsets = self.step * np.arange(-STEPS, STEPS + 1)
        scores = [self.score(offset) for offset in offsets]
        best, score = float(offsets[np.argmax(scores)]), max(scores)
        for halving in range(1, FINER + 1):
            for offset in (best - self.step / 2**halving, best + self.step / 2**halving):
                if (new := self.score(offset)) > score:
                    best, score = offset, new
        return self.at(best)

    def at(self, offset: float) -> F64:
        """All values with the one changed."""
        changed = np.array(self.values)
        changed[self.number] += offset
        return changed

    def score(self, offset: float) -> float:
        """Score of a change of the value, see the module; 0 where the scene cannot have it."""
        values, total = self.at(offset), 0.0
        if not self.looks[0].model.possible(values):
            return 0.0
        for look, others, data in zip(self.looks, self.others, self.data, strict=True):
            own = np.fft.fft(look.model.data(values).astype(np.complex128), axis=-1) - others
            energy = sum_energy(own)
            if energy > 0.0:
                cross = (data * own.conj()).sum(axis=0)
                variance = look.noise.variance(np.fft.ifft(data, axis=-1))
                total += _peak(cross) / (energy * variance)
        return total


def _peak(cross: C128) -> float:
    """Largest squared modulus of the correlation near no lag, from the cross spectrum (pulses, frequencies)."""
    sizes = [FINE * n for n in cross.shape]
    power = np.abs(np.fft.fft2(np.fft.fftshift(cross), s=sizes)) ** 2
    near = [np.r_[0 : min(FINE * LAGS, n // 2), max(n - FINE * LAGS, n // 2) : n] for n in sizes]
    return float(power[np.ix_(*near)].max())


def _apart(look: MeasuredLook, values: F64, number: int, part: MovingPart) -> float:
    """Largest difference of the points' change of slant range from the mean, m per unit of a value."""
    corners, mesh = look.model.traced_faces(values)
    velocity, _ = velocities(look.model, values, corners, mesh)
    along = velocity[number, part.faces] @ part.towards
    return float(np.abs(along - along.mean()).max())
