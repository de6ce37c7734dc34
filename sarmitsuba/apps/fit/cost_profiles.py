r"""Standard deviations from the profile of the cost, where that is no parabola over the errors of a value.

The covariance is that of a parabola. A rough surface whose mirror vanishes, or a level below the noise, has a cost that
rises on one side and is flat on the other. So the cost is followed along the change :math:`C_{\cdot k} / C_{kk}` of all
values with the k-th, by the covariance C, to either side, to where it rises by 2, which of a parabola is two standard
deviations (likelihood profiles, to first order in the other values); half the farther side counts.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial

import numpy as np

from sarmitsuba.apps.fit.least_squares import Prior, Problem, Solution, cost_of
from sarmitsuba.apps.fit.material_parameters import MaterialProperty
from sarmitsuba.apps.fit.parameter import Parameter
from sarmitsuba.core.arrays import F64
from sarmitsuba.scene.scene import Scene

# sides of an interval, standard deviations, and by how much the cost of a parabola rises there
SIDES, RISE = 2.0, 2.0
# range of rises there within which a cost is taken for a parabola
PARABOLA = (1.0, 4.0)
# share of its scale that a standard deviation must have for the cost to be followed, and from which it says nothing
CURVED, NOTHING = 0.02, 10.0
# farthest that a cost is followed, standard deviations, and halvings of the last step
FARTHEST, HALVINGS = 64.0, 5
# change in dB over which an amplitude is no longer straight
STRAIGHT_DB = 20.0 / np.log(10.0)


def scales(scene: Scene, parameters: tuple[Parameter, ...], values: F64) -> F64:
    """(n_values,) changes over which data stop being straight in a value: the property, or 8.7 dB; else infinite."""
    out, row = np.full(len(values), np.inf), 0
    for parameter in parameters:
        for name in parameter.names(scene):
            if isinstance(parameter, MaterialProperty):
                out[row] = abs(values[row])
            elif name.endswith("[dB]"):
                out[row] = STRAIGHT_DB
            row += 1
    return out


def profile_deviations(
    problem: Problem, found: Solution, covariance: F64, scale: F64, variances: F64, known: Mapping[int, Prior]
) -> F64:
    """(n_values,) standard deviations, at least those of the covariance; infinite where the cost does not rise.

    Parameters
    ----------
    found : solution
    covariance : (n, n) of its values
    scale : (n,) changes over which data stop being straight in a value
    variances : of each set's data
    known : priors by number of the value
    """
    sigma = np.sqrt(np.diag(covariance))
    least = cost_of(found.differences, found.values, known, variances)

    def rise(number: int, sign: float, way: float) -> float:
        """Rise of the cost so many standard deviations to one side; infinite at impossible values."""
        tried = found.values + sign * way * covariance[:, number] / sigma[number]
        if not problem.possible(tried):
            return np.inf
        return cost_of(problem.differences(tried), tried, known, variances) - least

    out = np.array(sigma)
    for number in np.flatnonzero(np.isfinite(sigma) & (sigma > CURVED * scale)):
        if sigma[number] > NOTHING * scale[number]:
            out[number] = np.inf
            continue
        sides = [_side(partial(rise, int(number), sign)) for sign in (1.0, -1.0)]
        out[number] = sigma[number] * max(1.0, *(side / SIDES for side in sides))
    return out


def _side(rise: Callable[[float], float]) -> float:
    """Standard deviations off at which a cost has risen by ``RISE``; ``SIDES`` where it is nearly a parabola."""
    near, far = 0.0, SIDES
    if PARABOLA[0] <= rise(far) <= PARABOLA[1]:
        return SIDES
    while rise(far) < RISE:
        near, far = far, 2.0 * far
        if far > FARTHEST:
            return float("inf")
    for _ in range(HALVINGS):
        middle = 0.5 * (near + far)
        near, far = (middle, far) if rise(middle) < RISE else (near, middle)
    return far
