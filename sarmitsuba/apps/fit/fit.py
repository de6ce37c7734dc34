"""Fit of parameters of a scene to measured raw data of one or several looks, coarse to fine."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import count

import numpy as np

from sarmitsuba.apps.fit.coarse_shapes import checked_offsets, coarse_shapes, other_cycles
from sarmitsuba.apps.fit.coarse_track import coarse_track
from sarmitsuba.apps.fit.confirmation import CONFIRMED, confirm_values, profile_deviations, scales
from sarmitsuba.apps.fit.derivative_witness import derivative_witnesses, is_refuted, warn_of
from sarmitsuba.apps.fit.form_search import searched_forms
from sarmitsuba.apps.fit.jacobian import Parameters
from sarmitsuba.apps.fit.least_squares import (
    Prior,
    Problem,
    Rows,
    Samples,
    Solution,
    checked_iterations,
    cost_of,
    energy,
    known_priors,
    minimise,
)
from sarmitsuba.apps.fit.measured_looks import MeasuredLook, looks_of
from sarmitsuba.apps.fit.model_error import EXCESS, error_of_model, misfit
from sarmitsuba.apps.fit.multilooked import fit_multilooked, window_of
from sarmitsuba.apps.fit.rival_cycles import OUT, Rival, likely, rival_cycles
from sarmitsuba.core.arrays import F64
from sarmitsuba.core.errors import SceneError
from sarmitsuba.core.witness import Witness
from sarmitsuba.machine.exclusive import exclusive
from sarmitsuba.scene.scene import Scene, SceneLike
from sarmitsuba.signal.raw_data import RawData

# how often the steps are taken, each time from the cycles of phase that the data confirm more
RETRIES = 3
# power of residuals over that of the noise from which the table says that the model lacks echoes
MISFIT = 1.5
# other cycles of phase from which the steps are taken to see whether they are as likely
RIVALS = 6


@dataclass(frozen=True, eq=False)
class Fit:
    """Fitted values with their covariance.

    Parameters
    ----------
    names : of the values, with their units in brackets
    start, values : (n,) float64, before and after the fit
    steps : (n_steps, n) values on the way: the start, after every round of the coarse start, after every accepted step
    covariance : (n, n) of the values, with the noise power that the residuals show; its diagonal from the profile of
        the cost where that is no parabola (:mod:`sarmitsuba.apps.fit.confirmation`): infinite where the data bound a
        value on one side only, such as the rms height of a surface whose mirror has vanished; and from the residuals
        of parts of the image where these say more, as echoes that the model lacks are no noise
        (:mod:`sarmitsuba.apps.fit.model_error`)
    bound : (n,) Cramer-Rao bound of the standard deviations with the radars' noise power; NaN for a noise temperature
        of 0
    confirmed : (n,) coherence of data and model over the echoes of the shape that a value moves (of a level: over the
        diffuse echoes of its material; of other values: over all echoes), without noise, see
        :mod:`sarmitsuba.apps.fit.confirmation`: 1 where the data hold them as the fit says, less where it is off by
        cycles of phase, 0 for data of another scene, whatever amplitudes are fitted; below ``CONFIRMED`` not
        confirmed. NaN by amplitude, and for shapes and materials without echoes
    costs : sum of squares of the residuals of all looks after every accepted step, the start first: W. By amplitude
        before every step, of averaged intensities relative to the data's, a window counted once: they rise where the
        window shrinks, as there are more of them and each has more speckle.
    windows : by amplitude the width of that window at each cost, range cells; else empty
    converged : whether the last step changed it by less than ``LEAST_CHANGE``
    residuals : raw data less the fitted ones, of each look
    unexplained : share of the energy of all measured raw data that the residuals hold: that of noise and of what the
        model lacks; near 1 for data of another scene, whatever the other numbers say
    scene : with the fitted values, as the first look sees it
    chi_squared : of each look, power of the residuals over that of the noise: as the radar states it, else of the two
        ray sets of the data, else of their weakest cells; 1 where the model explains all but noise. NaN by amplitude
    witnesses : by kind of parameter, error of the derivatives at these values in a central difference of plain runs,
        see :mod:`sarmitsuba.apps.fit.derivative_witness`; values whose derivatives it refutes are not confirmed
    """

    names: tuple[str, ...]
    start: F64
    values: F64
    steps: F64
    covariance: F64
    bound: F64
    confirmed: F64
    costs: tuple[float, ...]
    converged: bool
    residuals: tuple[RawData, ...]
    unexplained: float
    scene: Scene = field(repr=False)
    windows: tuple[float, ...] = ()
    chi_squared: F64 = field(default_factory=lambda: np.zeros(0))
    witnesses: Mapping[str, Witness] = field(default_factory=dict)

    @property
    def residual(self) -> RawData:
        """Raw data less the fitted ones, of the first look."""
        return self.residuals[0]

    @property
    def sigma(self) -> F64:
        """(n,) standard deviations of the values."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))

    def as_dict(self) -> dict[str, object]:
        """JSON-able form; numbers that are not known are None."""
        return {
            "names": list(self.names),
            "start": self.start.tolist(),
            "values": self.values.tolist(),
            "steps": self.steps.tolist(),
            "sigma": _finite_or_none(self.sigma),
            "bound": _finite_or_none(self.bound),
            "confirmed": _finite_or_none(self.confirmed),
            "covariance": [_finite_or_none(row) for row in self.covariance],
            "costs": list(self.costs),
            "windows": list(self.windows),
            "converged": self.converged,
            "unexplained": self.unexplained,
            "chi_squared": _finite_or_none(self.chi_squared),
            "witnesses": {kind: one.as_dict() for kind, one in self.witnesses.items()},
        }

    def table(self) -> str:
        """Table of the values, one line each."""
        width = max(len(name) for name in self.names)
        moves = np.isfinite(self.confirmed).any()
        lines = [
            f"{'parameter':{width}}  {'start':>12}  {'value':>12}  {'sigma':>9}  {'bound':>9}"
            + ("  confirmed" if moves else "")
        ]
        for name, start, value, sigma, bound, share in zip(
            self.names, self.start, self.values, self.sigma, self.bound, self.confirmed, strict=True
        ):
            least = "no noise" if math.isnan(bound) else f"{bound:.2g}"
            line = f"{name:{width}}  {start:12.6g}  {value:12.6g}  {sigma:9.2g}  {least:>9}"
            lines.append(line + (f"  {share:9.2f}" if moves else ""))
        said = "converged" if self.converged else "not converged"
        if self.windows:
            residual = f"{len(self.costs)} steps, residual {self.costs[-1]:.3g}"
            residual += f" in windows of {self.windows[-1]:g} range cells"
        else:
            residual = f"{len(self.costs) - 1} steps, residual {self.costs[-1]:.3g} W"
        lines.append(f"{said} after {residual}, {100.0 * self.unexplained:.3g} % of the data's energy")
        for number, ratio in enumerate(self.chi_squared, 1):
            if ratio > MISFIT:
                which = f" of look {number}" if len(self.chi_squared) > 1 else ""
                lines.append(
                    f"residual{which} is {ratio:.3g} times the noise: the model lacks echoes, and sigma holds what "
                    "their places show of it"
                )
        if self.witnesses:
            lines.append(
                "derivatives, measured here: "
                + ", ".join(f"{kind} {one.error_db:.0f} dB" for kind, one in self.witnesses.items())
            )
        doubtful = [name for name, share in zip(self.names, self.confirmed, strict=True) if share < CONFIRMED]
        if doubtful:
            lines.append(f"not confirmed by the phases of the data: {', '.join(doubtful)}")
        return "\n".join(lines)


def _finite_or_none(numbers: F64) -> list[float | None]:
    """Numbers as JSON has them: None for those that are not finite."""
    return [float(number) if np.isfinite(number) else None for number in numbers]


class _Complex(Problem):
    """Complex raw data of several looks; ``edges``: with derivatives by the parts that moving edges hide and show."""

    def __init__(self, looks: Sequence[MeasuredLook], *, edges: bool) -> None:
        self.looks, self.names, self.edges = tuple(looks), looks[0].model.names, edges
        self.norms = tuple(float(np.linalg.norm(look.measured)) for look in looks)

    def possible(self, values: F64) -> bool:
        """See the base class."""
        return self.looks[0].model.possible(values)

    def differences(self, values: F64) -> list[Samples]:
        """See the base class."""
        return [look.measured.astype(np.complex128) - look.model.data(values) for look in self.looks]

    def linearise(self, values: F64) -> tuple[list[Samples], list[Rows]]:
        """See the base class."""
        differences: list[Samples] = []
        jacobians: list[Rows] = []
        for look in self.looks:
            modelled, jacobian = look.model.derivative(values, edges=self.edges)
            differences.append(look.measured.astype(np.complex128) - modelled)
            jacobians.append(jacobian)
        return differences, jacobians

    def variances(self, differences: Sequence[Samples]) -> F64:
        """See the base class."""
        return np.array([look.noise.variance(d) for look, d in zip(self.looks, differences, strict=True)])


@exclusive
def fit(
    scene: SceneLike | Sequence[SceneLike],
    data: RawData | Sequence[RawData],
    parameters: Parameters,
    *,
    by: str = "complex",
    priors: Mapping[str, Prior] | None = None,
    iterations: int = 20,
    witness: bool = True,
    progress: Callable[[int, float], None] | None = None,
) -> Fit:
    r"""Fit parameters of a scene to raw data of one or several looks.

    Minimises :math:`\sum |d - m(x)|^2 / \sigma^2` over the complex samples of all looks, each with its own noise, and
    the deviations from the priors with Levenberg-Marquardt steps, see
    :func:`sarmitsuba.apps.fit.least_squares.minimise`.
    The covariance is :math:`(2 \sum H / (\sigma^2 s))^{-1}` with s samples per range cell, as the noise is flat over
    the radar's band alone.

    A track is first moved by the range errors of whole pulses, coarse to fine: their common part by the change of the
    phase over the band, which is unambiguous within a range cell, then by the phase of the carrier, unwrapped from
    pulse to pulse. Shapes that are shifted, stretched or scaled are first moved by the offsets of their echoes, up to
    a dozen range cells, see :mod:`sarmitsuba.apps.fit.shape_offsets`: by the peaks of correlations, then by the
    phases of the carrier in all looks, whose cycles the peaks tell; scales and rotations are searched for before, see
    :mod:`sarmitsuba.apps.fit.form_search`. In the end other cycles that may be as likely are tried, and the values are
    never worse than those of the start.

    Parameters
    ----------
    scene : with start values of the parameters; one for every raw data, or one that all radars of the data see. The
        radar is that of the data, and so are ray sets and seed, see
        :func:`sarmitsuba.apps.fit.measured_looks.looks_of`
    data : range compressed, of the scene's radar; or several looks
    parameters : as for :func:`sarmitsuba.jacobian`; of several looks none of a radar
    by : ``complex`` samples, or ``amplitude``: multilooked intensities of the images, for scatterers of unknown phase,
        see :mod:`sarmitsuba.apps.fit.multilooked`
    priors : by name of the value, with or without its unit
    iterations : most steps, at least 1
    witness : whether the derivatives by each kind of parameter are measured against a central difference at the end:
        two plain runs each
    progress : called with the number of each accepted step and its sum of squares, see ``costs``

    Returns
    -------
    fit : values, covariance, bound and residuals

    Raises
    ------
    SceneError, RadarError
        As for :func:`sarmitsuba.jacobian`; parameters that the data do not determine, or that several looks do not
        share; priors that are none, ``iterations`` that is no whole number of at least 1.
    DataError
        Data of other channels, pulses or samples than the scene's radar has.

    Notes
    -----
    Ignores the same as :func:`sarmitsuba.jacobian`. Of a shape whose scale and rotation are both off neither is found.
    Diffuse scatterers are those of the scene's seed: speckle of a real surface is not in the model.
    """
    iterations = checked_iterations(iterations)
    looks = looks_of(scene, data, parameters)
    model = looks[0].model
    known = known_priors(model.names, priors or {})
    numbers = count(1)
    report = None if progress is None else lambda cost: progress(next(numbers), cost)
    if by == "amplitude":
        return _fit_amplitude(looks, known, iterations, report)
    if by != "complex":
        raise SceneError(f"fit: by = {by!r} is neither complex nor amplitude")
    passed = [model.start]
    start = coarse_track(model, looks[0].measured, model.start, known) if len(looks) == 1 else model.start
    given, problem = start, _Complex(looks, edges=False)
    start = searched_forms(looks, start, passed.append)
    start, spread = coarse_shapes(looks, start, passed.append)
    best = None
    for _ in range(RETRIES):
        if best is None:
            problem, found = _begin_fit(looks, (start, given), known, iterations, report)
        else:
            found = minimise(problem, start, known, iterations, report, again=True)
        if best is not None and not _better(problem, found, best, known):
            break
        best = found
        passed += found.steps
        start = other_cycles(looks, found.values)
        if np.array_equal(start, found.values):
            start, spread = checked_offsets(looks, found.values)
        if np.array_equal(start, found.values):
            break
    assert best is not None
    best, rivals = _try_rivals(looks, problem, best, known, iterations, report)
    # offsets of envelopes that led astray: the steps from where it started are never worse than that
    if not np.array_equal(given, best.steps[0]) and not _lower(problem, best, given, known):
        found = minimise(problem, given, known, iterations, report, again=True)
        if _better(problem, found, best, known):
            best = found
            passed += found.steps
    share = confirm_values(looks, best.values)
    if not problem.edges and not (share[model.moving] >= CONFIRMED).all():
        # edges take most of the time, and change derivatives little where a shape's own echoes are found
        problem = _Complex(looks, edges=True)
        found = minimise(problem, best.values, known, iterations, report, again=True)
        passed += found.steps[1:]
        best = replace(found, costs=(*best.costs, *found.costs[1:]))
        share = confirm_values(looks, best.values)
    share = share * likely(rivals, len(best.values))
    return _conclude_fit(looks, problem, best, known, share, spread, passed, witness=witness)


def _conclude_fit(
    looks: Sequence[MeasuredLook],
    problem: _Complex,
    best: Solution,
    known: Mapping[int, Prior],
    share: F64,
    spread: F64,
    passed: Sequence[F64],
    *,
    witness: bool,
) -> Fit:
    """The fit with its quality: covariance, bound, misfit and witnesses of its derivatives."""
    model = looks[0].model
    variances = np.array([look.noise.shown(d) for look, d in zip(looks, best.differences, strict=True)])
    stated = np.array([look.noise.of_power(look.noise.stated) for look in looks])
    covariance = best.covariance(variances, known)
    # off by cycles of phase, perhaps: as exact as the envelopes are
    doubtful = (share < CONFIRMED) & model.moving
    scale = scales(model.scene, model.parameters, best.values)
    deviation = profile_deviations(problem, best, covariance, scale, variances, known)
    differences, jacobians = problem.linearise(best.values)
    shown = error_of_model(looks, differences, jacobians, variances, known)
    covariance[np.diag_indices(len(deviation))] = np.where(shown > EXCESS * deviation, shown, deviation) ** 2
    covariance[doubtful, doubtful] += np.where(np.isnan(spread), np.inf, spread)[doubtful] ** 2
    found: dict[str, Witness] = {}
    if witness:
        found = _witnesses(looks, best.values, differences, jacobians, edges=problem.edges)
        refuted = {kind for kind, one in found.items() if is_refuted(one)}
        share = np.where(
            [name.partition(":")[0].split(" ")[0] in refuted for name in model.names], 0.0, share
        )
    chi_squared = np.array([misfit(look, d) for look, d in zip(looks, differences, strict=True)])
    result = _result(looks, best, covariance, best.bound(stated, known), share, passed)
    return replace(result, chi_squared=chi_squared, witnesses=found)


def _witnesses(
    looks: Sequence[MeasuredLook],
    values: F64,
    differences: Sequence[Samples],
    jacobians: Sequence[Rows],
    *,
    edges: bool,
) -> dict[str, Witness]:
    """Witnesses of the derivatives in a drawn look."""
    seed = looks[0].model.scene.settings.seed
    number = int(np.random.default_rng([seed, 0xF17]).integers(len(looks)))
    look = looks[number]
    data = np.asarray(look.measured - differences[number], dtype=np.complex128)
    rows = np.asarray(jacobians[number], dtype=np.complex64)
    found = derivative_witnesses(look.model, values, data, rows, seed, edges=edges)
    warn_of(look.model.scene.name, found)
    return found


def _begin_fit(
    looks: Sequence[MeasuredLook],
    starts: Sequence[F64],
    known: Mapping[int, Prior],
    iterations: int,
    report: Callable[[float], None] | None,
) -> tuple[_Complex, Solution]:
    """The first solution from one of the starts, and its problem: with moving edges where a shape only hides and shows.

    Raises
    ------
    SceneError : values that the data do not determine at any of them
    """
    failures = []
    for edges in (False, True) if looks[0].model.moving.any() else (False,):
        problem = _Complex(looks, edges=edges)
        for start in starts:
            try:
                return problem, minimise(problem, start, known, iterations, report)
            except SceneError as failure:
                failures.append(failure)
    raise failures[-1]


def _try_rivals(
    looks: Sequence[MeasuredLook],
    problem: Problem,
    best: Solution,
    known: Mapping[int, Prior],
    iterations: int,
    report: Callable[[float], None] | None,
) -> tuple[Solution, list[Rival]]:
    """The best solution at other cycles of phase that may be as likely, and those that are left."""
    rivals, tried = rival_cycles(looks, best.values, known), list[Rival]()
    for _ in range(RIVALS):
        if not rivals:
            break
        found = minimise(problem, rivals[0].values, known, iterations, report, again=True)
        if _better(problem, found, best, known):
            best, rivals, tried = found, rival_cycles(looks, found.values, known), []
            continue
        variances = problem.variances(best.differences)
        costs = [cost_of(one.differences, one.values, known, variances) for one in (best, found)]
        tried.append(replace(rivals[0], advantage=costs[0] - costs[1]))
        rivals = rivals[1:]
    return best, rivals + [rival for rival in tried if rival.advantage > OUT]


def _better(problem: Problem, found: Solution, other: Solution, known: Mapping[int, Prior]) -> bool:
    """Whether a solution has the lower cost of two."""
    variances = problem.variances(other.differences)
    costs = [cost_of(one.differences, one.values, known, variances) for one in (found, other)]
    return costs[0] < costs[1]


def _lower(problem: Problem, found: Solution, values: F64, known: Mapping[int, Prior]) -> bool:
    """Whether a solution has a lower cost than some values."""
    variances = problem.variances(found.differences)
    own = cost_of(found.differences, found.values, known, variances)
    return own < cost_of(problem.differences(values), values, known, variances)


def _fit_amplitude(
    looks: Sequence[MeasuredLook],
    known: Mapping[int, Prior],
    iterations: int,
    report: Callable[[float], None] | None,
) -> Fit:
    """Fit to multilooked intensities, with windows from coarse to fine."""
    found, covariance = fit_multilooked(looks, looks[0].model.start, known, iterations, report)
    none: F64 = np.full(len(found.values), np.nan)
    windows = tuple(window_of(step) for step in range(1, len(found.costs) + 1))
    return _result(looks, found, covariance, none, none, found.steps, windows)


def _result(
    looks: Sequence[MeasuredLook],
    found: Solution,
    covariance: F64,
    bound: F64,
    share: F64,
    passed: Sequence[F64],
    windows: tuple[float, ...] = (),
) -> Fit:
    """A fit from its solution."""
    model, values = looks[0].model, found.values
    residuals = _Complex(looks, edges=False).differences(values)
    return Fit(
        model.names,
        model.start,
        values,
        np.array(passed),
        covariance,
        bound,
        share,
        found.costs,
        found.converged,
        tuple(look.residual(d) for look, d in zip(looks, residuals, strict=True)),
        energy(residuals) / energy([look.measured.astype(np.complex128) for look in looks]),
        model.at(values),
        windows,
    )
