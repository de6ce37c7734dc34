r"""Whether measured data hold the echoes of a shape as the model has them: coherence over the shape's echoes.

With the echoes m of a shape and the data d less the model's echoes of all others, both focused about the shape
(deramped and transformed, which keeps energies and products), and the cells S in which the model has most of the
shape's energy,

.. math:: \gamma = \frac{\Re \sum_S d \, m^*}{\sqrt{\sum_S |m|^2 \, (\sum_S |d|^2 - N)}}

with the noise's energy N in S: 1 where data and model are alike up to a factor and noise, whatever the amplitudes that
are fitted, :math:`\langle \cos \varphi \rangle` with errors :math:`\varphi` of the phase, and about 0 for data of
another scene. There, with K cells that count, one of T values looked at exceeds :math:`\gamma` by chance with a
probability of at most :math:`T (1 - \gamma^2)^{K - 1}` (Carter, Knapp and Nuttall 1973, for uncorrelated Gaussian
data).

Standard deviations from the profile of the cost, where that is no parabola over the errors of a value.

The covariance is that of a parabola. A rough surface whose mirror vanishes, or a level below the noise, has a cost that
rises on one side and is flat on the other. So the cost is followed along the change :math:`C_{\cdot k} / C_{kk}` of all
values with the k-th, by the covariance C, to either side, to where it rises by 2, which of a parabola is two standard
deviations (likelihood profiles, to first order in the other values); half the farther side counts.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from sarmitsuba.apps.fit.forward_model import ForwardModel
from sarmitsuba.apps.fit.least_squares import Prior, Problem, Solution, cost_of
from sarmitsuba.apps.fit.material_parameters import Level, MaterialProperty
from sarmitsuba.apps.fit.measured_looks import ROUNDING, MeasuredLook
from sarmitsuba.apps.fit.parameter import Parameter
from sarmitsuba.apps.fit.shape_offsets import echoes, frequencies, moving_parts
from sarmitsuba.core.arrays import C64, C128, F64, sum_energy
from sarmitsuba.core.constants import SPEED_OF_LIGHT
from sarmitsuba.scene.scene import Scene

# coherence from which a shape counts as confirmed: that of phases uniform within an eighth of a turn, so of points that
# are off by up to a sixteenth of a wavelength, within which data are nearly linear in the values
CONFIRMED = float(np.sin(0.25 * np.pi) / (0.25 * np.pi))
# share of the energy of a shape's model that the cells hold which are compared
HELD = 0.9
# cells of range and azimuth over which intensities are averaged before the cells are chosen
SMOOTHED = 3
# standard errors of the noise's energy by which the data's must exceed it to count as echoes
SEEN = 4.0
# values that a fit looks at: places of the envelopes and cycles of phase
LOOKED_AT = 1e4
# quantile of the averaged intensity of the data that bounds the noise where the radar states none
WEAKEST = 0.1

# dB of a factor e of amplitudes
DB = 20.0 / float(np.log(10.0))


@dataclass(frozen=True, eq=False)
class Coherence:
    """Sums over the cells of a shape's echoes, over the variance of the noise.

    Parameters
    ----------
    both : real part of the sum of data times conjugate model
    model, data : energies; that of the data without noise
    spread : standard error of the noise's energy
    fourth : sum of squared intensities of the model, from which the cells that count follow
    """

    both: float = 0.0
    model: float = 0.0
    data: float = 0.0
    spread: float = 0.0
    fourth: float = 0.0

    def plus(self, other: Coherence) -> Coherence:
        """Sums over both."""
        return Coherence(
            self.both + other.both,
            self.model + other.model,
            self.data + other.data,
            float(np.hypot(self.spread, other.spread)),
            self.fourth + other.fourth,
        )

    @property
    def coherence(self) -> float:
        """See the module; 0 where the data have no echoes, NaN without a model of any."""
        if not self.model > 0.0:
            return float("nan")
        if self.data <= SEEN * self.spread:
            return 0.0
        return min(self.both / float(np.sqrt(self.model * self.data)), 1.0)

    @property
    def share(self) -> float:
        """The same times the probability that it is not there by chance."""
        coherence, cells = self.coherence, self.model**2 / self.fourth if self.fourth > 0.0 else 1.0
        if not coherence > 0.0:
            return coherence
        # noise bounds from below what can be known of the part that is not alike
        unlike = max(1.0 - coherence**2, self.spread / self.data)
        chance = float(LOOKED_AT * unlike ** max(cells - 1.0, 0.0))
        return coherence * (1.0 - min(chance, 1.0))


def coherences(
    looks: Sequence[MeasuredLook], values: F64, numbers: NDArray[np.intp] | None = None
) -> tuple[dict[int, Coherence], dict[int, NDArray[np.bool_]]]:
    """Coherence of every shape that values move, by mesh, and which values these are.

    ``numbers`` : only shapes that one of these values moves
    """
    found: dict[int, Coherence] = {}
    moves: dict[int, NDArray[np.bool_]] = {}
    for look in looks:
        parts = moving_parts(look.model, values, whole=True)
        parts = [part for part in parts if numbers is None or part.moves[numbers].any()]
        if not parts:
            continue
        modelled, spectra = echoes(look.model, values, parts)
        left = np.fft.fft((look.measured - modelled).astype(np.complex128), axis=-1)
        noise = None
        for part, own in zip(parts, spectra, strict=True):
            if noise is None:
                noise = _noise(look, part.center, left)
            one = _coherence(look.model, part.center, own, left, noise, look.noise.samples)
            found[part.mesh] = found.get(part.mesh, Coherence()).plus(one)
            moves[part.mesh] = moves.get(part.mesh, part.moves) | part.moves
    return found, moves


def confirm_values(looks: Sequence[MeasuredLook], values: F64) -> F64:
    """(n_values,) least share of confirmed echoes of the shapes that each value moves, see :class:`Coherence`.

    Of a level that of the diffuse echoes of its material, of other values that move no shape that of all echoes in the
    cells that they change; NaN for shapes and materials without echoes.
    """
    found, moves = coherences(looks, values)
    out = least(((moves[mesh], one.share) for mesh, one in found.items()), len(values))
    still = ~np.any([np.zeros(len(values), dtype=np.bool_), *moves.values()], axis=0)
    of_cells = measure_scatter(looks, values)
    still[list(of_cells)] = False
    of_cells |= where_changed(looks, values, np.flatnonzero(still))
    for number, one in of_cells.items():
        out[number] = one.share
    return out


def measure_scatter(looks: Sequence[MeasuredLook], values: F64) -> dict[int, Coherence]:
    """Coherence of the diffuse echoes of every material whose level is fitted, by the number of the value.

    The derivative of data by a level in dB is ln(10)/20 of these echoes (of those between two surfaces of the same
    material, which have two such amplitudes, twice as much).
    """
    found: dict[int, Coherence] = {}
    for look in looks:
        numbers = _levels(look.model)
        if not numbers:
            continue
        by = list(numbers.values())
        modelled, slopes = look.model.derivative(values, by=by)
        left = np.fft.fft((look.measured - modelled).astype(np.complex128), axis=-1)
        center = look.model.sampling.window.center
        noise = _noise(look, center, left)
        for number, slope in zip(numbers, slopes, strict=True):
            own = np.fft.fft(slope.astype(np.complex128) * DB, axis=-1)
            one = _coherence(look.model, center, own, left, noise, look.noise.samples)
            found[number] = found.get(number, Coherence()).plus(one)
    return found


def _levels(model: ForwardModel) -> dict[int, Level]:
    """Levels among the parameters, by the numbers of their values."""
    found, number = dict[int, Level](), 0
    for parameter in model.parameters:
        if isinstance(parameter, Level):
            found[number] = parameter
        number += len(parameter.names(model.scene))
    return found


def where_changed(
    looks: Sequence[MeasuredLook], values: F64, numbers: NDArray[np.intp]
) -> dict[int, Coherence]:
    """Coherence of all echoes in the cells that hold most of the energy of the derivative by each of some values.

    Echoes elsewhere say nothing of a value: a permittivity is that of the few cells of corners with the ground.
    """
    found: dict[int, Coherence] = {}
    for look in looks:
        if not len(numbers):
            break
        modelled, slopes = look.model.derivative(values)
        own, left = (
            np.fft.fft(one.astype(np.complex128), axis=-1) for one in (modelled, look.measured - modelled)
        )
        center = look.model.sampling.window.center
        noise = _noise(look, center, left)
        for number in map(int, numbers):
            slope = np.fft.fft(slopes[number].astype(np.complex128), axis=-1)
            one = _coherence(look.model, center, own, left, noise, look.noise.samples, slope)
            found[number] = found.get(number, Coherence()).plus(one)
    return found


def least(shares: Iterable[tuple[NDArray[np.bool_], float]], n_values: int) -> F64:
    """(n_values,) least of the numbers of the shapes that each value moves; NaN where there is none."""
    out = np.full(n_values, np.nan)
    for moved, share in shares:
        out[moved] = np.fmin(out[moved], share)
    return out


def _coherence(
    model: ForwardModel,
    center: F64,
    own: C128,
    left: C128,
    noise: float,
    samples: float,
    changed: C128 | None = None,
) -> Coherence:
    """Sums of one look from the spectra of some echoes and of the residual data.

    Parameters
    ----------
    center : (3,) m, middle of the scatterers
    noise : mean power of a cell, in the units of the data, W
    samples : of a range cell, which are alike
    changed : spectrum whose cells are compared; None: those of the echoes
    """
    modelled = focus_spectra(model, center, own)
    measured = modelled + focus_spectra(model, center, left)
    chosen = _own_cells(np.abs(modelled if changed is None else focus_spectra(model, center, changed)) ** 2)
    count = int(chosen.sum())
    if count == 0:
        return Coherence()
    m, d = modelled[chosen], measured[chosen]
    weight = 1.0 / noise
    energy = sum_energy(m)
    return Coherence(
        float(np.vdot(m, d).real) * weight,
        energy * weight,
        (sum_energy(d) - noise * count) * weight,
        float(np.sqrt(count * samples)),
        float(np.sum(np.abs(m) ** 4)) * weight**2 * samples,
    )


def _own_cells(power: F64) -> NDArray[np.bool_]:
    """Cells with the largest averaged intensities that hold ``HELD`` of the energy; ``power``: (channels, ...)."""
    from scipy.ndimage import uniform_filter

    smooth = uniform_filter(power, (1, SMOOTHED, SMOOTHED), mode="wrap")
    order = np.argsort(smooth, axis=None)[::-1]
    held = np.cumsum(power.reshape(-1)[order])
    out = np.zeros(power.size, dtype=np.bool_)
    if held[-1] > 0.0:
        out[order[: int(np.searchsorted(held, HELD * held[-1])) + 1]] = True
    return out.reshape(power.shape)


def focus_spectra(model: ForwardModel, center: F64, spectrum: C128) -> C128:
    """Spectra (channels, pulses, frequencies) as an image about a point (channels, azimuths, ranges), energies kept."""
    radar = model.scene.radar
    frequency = frequencies(radar.window.n_samples, radar.window.sample_spacing)
    away = radar.slant_range(center)
    turn = (
        radar.waveform.center_frequency * away[:, None]
        + frequency * (away - radar.window.start_range)[:, None]
    )
    deramped = spectrum * np.exp(4j * np.pi / SPEED_OF_LIGHT * turn)
    return np.asarray(np.fft.fft(np.fft.ifft(deramped, axis=-1), axis=-2, norm="ortho"))


def weakest_cells(model: ForwardModel, center: F64, measured: C64) -> float:
    """Intensity that ``WEAKEST`` of the cells of data about a point, averaged, are below, a bound of the noise, W."""
    from scipy.ndimage import uniform_filter

    image = focus_spectra(model, center, np.fft.fft(measured.astype(np.complex128), axis=-1))
    smooth = uniform_filter(np.abs(image) ** 2, (1, SMOOTHED, SMOOTHED), mode="wrap")
    return float(np.quantile(smooth, WEAKEST))


def _noise(look: MeasuredLook, center: F64, left: C128) -> float:
    """Mean noise power of a sample, W: as stated, else at most that of the residual and of the weakest cells.

    At least the rounding of float32.
    """
    if look.noise.stated > 0.0:
        return look.noise.stated
    weakest = weakest_cells(look.model, center, look.measured)
    residual = float(np.mean(np.abs(np.fft.ifft(left, axis=-1)) ** 2))
    return max(min(weakest, residual), ROUNDING * look.noise.least)


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
