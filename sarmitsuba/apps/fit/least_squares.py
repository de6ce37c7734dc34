"""Least squares of several sets of data with priors: Levenberg-Marquardt steps, covariance and bound."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from numbers import Integral, Real
from typing import TypeAlias

import numpy as np

from sarmitsuba.core.arrays import C64, C128, F32, F64
from sarmitsuba.core.errors import SceneError
from sarmitsuba.core.parameters import one_line

# data, and derivatives of a model of them, complex or real
Samples: TypeAlias = "C128 | F64"
Rows: TypeAlias = "C64 | F32"
# damping relative to the diagonal of the normal equations: first, and by what it grows and falls
FIRST_DAMPING, GROWS, FALLS = 1e-3, 10.0, 0.2
# a step ends the fit when it changes the sum of squares by less than this share
LEAST_CHANGE = 1e-7
# share of a predicted change of the data by which the true one may differ before the Jacobian is computed anew
STRAIGHT = 0.03
# share of the norm of the data below which such a difference is rounding
ROUNDED = 1e-5
# most attempts at a step that lowers the sum of squares
ATTEMPTS = 8
# least eigenvalue of the correlations of the derivatives: below, values have ten thousand times the sigma of each alone
LEAST_WEIGHT = 1e-8
# largest modulus of a prior's mean, and of its standard deviation and one over it: beyond, their squares overflow
MOST_PRIOR = 1e70


@dataclass(frozen=True)
class Prior:
    """Prior knowledge of a value: its mean and standard deviation, in the value's unit."""

    mean: float
    sigma: float


def known_priors(names: Sequence[str], priors: Mapping[str, Prior]) -> dict[int, Prior]:
    """Priors by number of their value.

    Raises
    ------
    SceneError : no such value, no prior of two numbers, or numbers whose squares or ratios overflow
    """
    short = [name.rsplit(" [", 1)[0] for name in names]
    known = {}
    if not isinstance(priors, Mapping):
        raise SceneError(f"priors: {_format_given(priors)} is no mapping; give {{name: Prior(mean, sigma)}}")
    for name, prior in priors.items():
        numbers = isinstance(prior, Prior) and isinstance(prior.mean, Real) and isinstance(prior.sigma, Real)
        if not numbers:
            raise SceneError(
                f"prior of {name!r}: {_format_given(prior)} is no prior; give sarmitsuba.Prior(mean, sigma)"
            )
        if name not in names and name not in short:
            raise SceneError(f"prior of {name!r}: no such parameter; there are {', '.join(names)}")
        if not abs(prior.mean) <= MOST_PRIOR:
            raise SceneError(f"prior of {name!r}: mean = {prior.mean:g} must be within {MOST_PRIOR:g} of 0")
        if not (1.0 / MOST_PRIOR <= prior.sigma <= MOST_PRIOR or prior.sigma == np.inf):
            raise SceneError(
                f"prior of {name!r}: sigma = {prior.sigma:g} must be from {1.0 / MOST_PRIOR:g} to {MOST_PRIOR:g}, or "
                "infinite"
            )
        number = list(names).index(name) if name in names else short.index(name)
        known[number] = prior
    return known


def checked_iterations(iterations: object) -> int:
    """Largest number of steps.

    Raises
    ------
    SceneError : no whole number, or below 1
    """
    if isinstance(iterations, bool) or not isinstance(iterations, Integral) or int(iterations) < 1:
        raise SceneError(
            f"fit: iterations = {_format_given(iterations)} must be a whole number of at least 1"
        )
    return int(iterations)


def _format_given(given: object) -> str:
    return one_line(repr(given))


class Problem(ABC):
    r"""Sets of data d as functions m(x) of values x, of which :math:`\sum |d - m(x)|^2 / \sigma^2` is minimised.

    Attributes
    ----------
    names : of the values
    norms : of the data of each set
    """

    names: tuple[str, ...]
    norms: tuple[float, ...]

    @abstractmethod
    def differences(self, values: F64) -> list[Samples]:
        """Data less model of each set."""

    @abstractmethod
    def linearise(self, values: F64) -> tuple[list[Samples], list[Rows]]:
        """The same, with the derivatives of the model (n_values, ...) of each set."""

    def possible(self, values: F64) -> bool:
        """Whether the model can have these values; steps to others are damped."""
        return True

    @abstractmethod
    def variances(self, differences: Sequence[Samples]) -> F64:
        """(n_sets,) mean of ``|d - m|^2`` that the noise gives a sample, by which the sets are weighed."""


@dataclass(frozen=True, eq=False)
class Solution:
    """Values that minimise a sum of squares.

    Parameters
    ----------
    values : (n,) float64
    steps : values after every accepted step, the start first
    differences : data less model of each set
    normals : matrix Re J^H J of each set
    costs : sum of squares of all sets after every accepted step, the start first
    converged : whether the last step changed it by less than ``LEAST_CHANGE``
    """

    values: F64
    steps: tuple[F64, ...]
    differences: list[Samples]
    normals: list[F64]
    costs: tuple[float, ...]
    converged: bool

    def covariance(self, variances: F64, known: Mapping[int, Prior]) -> F64:
        """(n, n) of the values, from the variance of each set's data and from the priors."""
        information = np.zeros((len(self.values), len(self.values)))
        for normal, variance in zip(self.normals, variances, strict=True):
            information += 2.0 * normal / variance
        for k, prior in known.items():
            information[k, k] += 1.0 / prior.sigma**2
        # values that the data no longer depend on, such as a level that shrank to nothing
        seen = np.diag(information) > 0.0
        out = np.diag(np.where(seen, 0.0, np.inf))
        out[np.ix_(seen, seen)] = np.linalg.inv(information[np.ix_(seen, seen)])
        return out

    def bound(self, variances: F64, known: Mapping[int, Prior]) -> F64:
        """(n,) Cramer-Rao bound of the standard deviations with stated variances; NaN where one is not stated."""
        if not (variances > 0.0).all():
            return np.full(len(self.values), np.nan)
        return np.asarray(np.sqrt(np.diag(self.covariance(variances, known))), dtype=np.float64)


def minimise(
    problem: Problem,
    start: F64,
    known: Mapping[int, Prior],
    iterations: int,
    progress: Callable[[float], None] | None = None,
    *,
    again: bool = False,
) -> Solution:
    r"""Levenberg-Marquardt steps from start values.

    .. math:: (H + \mu \, \mathrm{diag} H) \, \delta = g, \quad H = \Re J^H J, \quad g = \Re J^H (d - m)

    H and g are summed over the sets, each over its variance. The Jacobian is kept for the next step where the data
    followed it to ``STRAIGHT`` of their change. ``again``: from values of an earlier solution, where data that
    determine nothing end the steps without an error.

    Raises
    ------
    SceneError : values that the data do not determine at the start
    """
    values = np.asarray(start, dtype=np.float64)
    differences, jacobians = problem.linearise(values)
    steps, costs, damping, converged = [values], [energy(differences)], FIRST_DAMPING, False
    for step in range(1, iterations + 1):
        variances = problem.variances(differences)
        cost = cost_of(differences, values, known, variances)
        normal, right, _ = normal_sums(jacobians, differences, variances, values, known)
        try:
            check_determined(problem.names, normal, known)
        except SceneError:
            if step == 1 and not again:
                raise
            break  # the steps led to where the data determine nothing
        for _ in range(ATTEMPTS):
            change = np.asarray(
                np.linalg.solve(normal + damping * np.diag(np.diag(normal)), right), dtype=np.float64
            )
            tried = values + change
            if problem.possible(tried):
                left = problem.differences(tried)
                new = cost_of(left, tried, known, variances)
                if new < cost:
                    break
            damping *= GROWS
        else:
            converged = True
            break
        damping *= FALLS
        follows = all(
            _follows(jacobian, change, before - after, norm)
            for jacobian, before, after, norm in zip(jacobians, differences, left, problem.norms, strict=True)
        )
        values, differences, converged = tried, left, cost - new < LEAST_CHANGE * cost
        steps.append(values)
        costs.append(energy(differences))
        if progress is not None:
            progress(costs[-1])
        if converged or step == iterations:
            break
        if not follows:
            _, jacobians = problem.linearise(values)
    normals = [normal_equations(j, d)[0] for j, d in zip(jacobians, differences, strict=True)]
    return Solution(values, tuple(steps), differences, normals, tuple(costs), converged)


def normal_sums(
    jacobians: Sequence[Rows],
    differences: Sequence[Samples],
    variances: F64,
    values: F64,
    known: Mapping[int, Prior],
) -> tuple[F64, F64, list[F64]]:
    """Matrix and right side of the normal equations of all sets over their variances, with priors; each set's."""
    normal, right = np.zeros((len(values), len(values))), np.zeros(len(values))
    normals = []
    for jacobian, difference, variance in zip(jacobians, differences, variances, strict=True):
        own_normal, own_right = normal_equations(jacobian, difference)
        normals.append(own_normal)
        normal += own_normal / variance
        right += own_right / variance
    for k, prior in known.items():
        normal[k, k] += 0.5 / prior.sigma**2
        right[k] += 0.5 * (prior.mean - values[k]) / prior.sigma**2
    return normal, right, normals


def energy(differences: Sequence[Samples]) -> float:
    """Sum of squares of all sets."""
    return float(sum(np.sum(np.abs(difference) ** 2) for difference in differences))


def cost_of(differences: Sequence[Samples], values: F64, known: Mapping[int, Prior], variances: F64) -> float:
    """Sum of squares of data and priors over their variances."""
    own = sum(
        float(np.sum(np.abs(difference) ** 2) / variance)
        for difference, variance in zip(differences, variances, strict=True)
    )
    return own + 0.5 * sum(float((values[k] - p.mean) / p.sigma) ** 2 for k, p in known.items())


def normal_equations(jacobian: Rows, difference: Samples) -> tuple[F64, F64]:
    """Matrix Re J^H J and right side Re J^H (d - m), in float64, of real and imaginary parts side by side."""
    n = len(jacobian)
    rows = np.ascontiguousarray(jacobian).reshape(n, -1).view(np.float32)
    flat = difference.reshape(-1).view(np.float64)
    normal, right = np.zeros((n, n)), np.zeros(n)
    step = max(1, 2**24 // n)  # bounds the float64 copy
    for k in range(0, flat.size, step):
        part = rows[:, k : k + step].astype(np.float64)
        normal += part @ part.T
        right += part @ flat[k : k + step]
    return normal, right


def _follows(jacobian: Rows, change: F64, difference: Samples, norm: float) -> bool:
    """Whether data of a norm changed by ``difference`` as the Jacobian predicts it for a change of the values."""
    predicted = np.tensordot(change.astype(np.float32), jacobian, 1)
    off = float(np.linalg.norm(difference - predicted))
    return off <= max(STRAIGHT * float(np.linalg.norm(predicted)), ROUNDED * norm)


def check_determined(names: tuple[str, ...], normal: F64, known: Mapping[int, Prior]) -> None:
    """Refuse values on which the data do not depend, or of which they give only a sum that no priors separate.

    ``normal`` holds the information of data and priors. Priors are far weaker than exact data, and still separate: a
    direction that rests on them for at least half of its information is determined.
    """
    own = np.diag(normal)
    for name, value in zip(names, own, strict=True):
        if not value > 0.0:
            raise SceneError(f"fit: the data do not depend on {name}; leave it out or give a prior")
    scaled = normal / np.sqrt(np.outer(own, own))
    weight, vectors = np.linalg.eigh(scaled)
    prior = np.zeros(len(own))
    for k, one in known.items():
        prior[k] = 0.5 / one.sigma**2 / own[k]
    # of each direction: too little information, and most of it not from priors
    unknown = (weight < LEAST_WEIGHT) & (prior @ vectors**2 < 0.5 * np.abs(weight))
    if unknown.any():
        worst = np.argsort(-np.abs(vectors[:, unknown.argmax()]))[:3]
        raise SceneError(
            f"fit: the data determine only sums of {', '.join(names[k] for k in sorted(worst))}; leave some out or "
            "give priors"
        )
