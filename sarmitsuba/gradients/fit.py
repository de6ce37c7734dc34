"""Fit of parameters of a scene to measured raw data: Levenberg-Marquardt with the Jacobian, covariance and bound."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from sarmitsuba.arrays import C64, C128, F64
from sarmitsuba.constants import SPEED_OF_LIGHT
from sarmitsuba.echo.noise import noise_power
from sarmitsuba.echo.raw_data import RawData
from sarmitsuba.errors import DataError, SceneError
from sarmitsuba.exclusive import exclusive
from sarmitsuba.gradients.forward_model import ForwardModel
from sarmitsuba.gradients.jacobian import Parameters, parameters_of
from sarmitsuba.gradients.radar_parameters import AntennaTrack
from sarmitsuba.scene.scene import Scene, SceneLike

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
# largest distance of the receive windows of data and scene, m
SAME_WINDOW = 1e-3
# least eigenvalue of the correlations of the derivatives: below, values have ten thousand times the sigma of each alone
LEAST_WEIGHT = 1e-8
# noise power relative to that of the data that priors are weighed against at least
LEAST_NOISE = 1e-6
# rounding of float32 data, as a share of that
ROUNDING = 2.0**-48 / LEAST_NOISE
# weight of a track's displacement across the line of sight, relative to the range error, in the coarse start
ACROSS = 1e-3
# rounds of the coarse start
ROUNDS = 3
# shares of the energy of the strongest pulse from which a pulse counts in the coarse start
LIT = 1e-4


@dataclass(frozen=True)
class Prior:
    """What is known of a value beforehand: its mean and standard deviation, in the value's unit."""

    mean: float
    sigma: float


@dataclass(frozen=True, eq=False)
class Fit:
    """Fitted values with their covariance.

    Parameters
    ----------
    names : of the values, with their units in brackets
    start, values : (n,) float64, before and after the fit
    covariance : (n, n) of the values, with the noise power that the residuals show
    bound : (n,) Cramer-Rao bound of the standard deviations with the radar's noise power; NaN for a noise temperature
        of 0
    costs : sum of squares of the residuals, sqrt(W) squared, after every accepted step, the start first
    converged : whether the last step changed it by less than ``LEAST_CHANGE``
    residual : raw data less the fitted ones
    scene : with the fitted values
    """

    names: tuple[str, ...]
    start: F64
    values: F64
    covariance: F64
    bound: F64
    costs: tuple[float, ...]
    converged: bool
    residual: RawData
    scene: Scene = field(repr=False)

    @property
    def sigma(self) -> F64:
        """(n,) standard deviations of the values."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))

    def as_dict(self) -> dict[str, object]:
        """JSON-able form; a bound that is not known is None."""
        return {
            "names": list(self.names),
            "start": self.start.tolist(),
            "values": self.values.tolist(),
            "sigma": self.sigma.tolist(),
            "bound": [float(b) if np.isfinite(b) else None for b in self.bound],
            "covariance": self.covariance.tolist(),
            "costs": list(self.costs),
            "converged": self.converged,
        }

    def table(self) -> str:
        """Table of the values, one line each."""
        width = max(len(name) for name in self.names)
        lines = [f"{'parameter':{width}}  {'start':>12}  {'value':>12}  {'sigma':>9}  {'bound':>9}"]
        for row in zip(self.names, self.start, self.values, self.sigma, self.bound, strict=True):
            name, start, value, sigma, bound = row
            lines.append(f"{name:{width}}  {start:12.6g}  {value:12.6g}  {sigma:9.2g}  {bound:9.2g}")
        said = "converged" if self.converged else "not converged"
        lines.append(f"{said} after {len(self.costs) - 1} steps, residual {self.costs[-1]:.3g} W")
        return "\n".join(lines)


@exclusive
def fit(
    scene: SceneLike,
    data: RawData,
    parameters: Parameters,
    *,
    priors: Mapping[str, Prior] | None = None,
    iterations: int = 20,
    progress: Callable[[int, float], None] | None = None,
) -> Fit:
    r"""Fit parameters of a scene to raw data.

    Minimises :math:`\sum |d - m(x)|^2 / \sigma^2` over the complex samples and the deviations from the priors with
    Levenberg-Marquardt steps,

    .. math:: (H + \mu \, \mathrm{diag} H) \, \delta = g, \quad H = \Re J^H J, \quad g = \Re J^H (d - m)

    The Jacobian is kept for the next step where the data followed it to ``STRAIGHT`` of their change. The covariance is
    :math:`(2 H / (\sigma^2 s))^{-1}` with s samples per range cell, as the noise is flat over the
    radar's band alone.

    A track is first moved by the range errors of whole pulses, coarse to fine: their common part by the change of the
    phase over the band, which is unambiguous within a range cell, then by the phase of the carrier, unwrapped from
    pulse to pulse.

    Parameters
    ----------
    scene : with start values of the parameters
    data : range compressed, of the scene's radar
    parameters : as for :func:`sarmitsuba.jacobian`
    priors : by name of the value, with or without its unit
    iterations : most steps
    progress : called with the number of each accepted step and its sum of squares, W

    Returns
    -------
    fit : values, covariance, bound and residuals

    Raises
    ------
    SceneError, RadarError
        As for :func:`sarmitsuba.jacobian`; or parameters that the data do not determine.
    DataError
        Data of other channels, pulses or samples than the scene's radar has.

    Notes
    -----
    Ignores the same as :func:`sarmitsuba.jacobian`; shifts of shapes must start within an eighth of a wavelength.
    Diffuse scatterers are those of the scene's seed: speckle of a real surface is not in the model.
    """
    scene = Scene.of(scene)
    given = parameters_of(parameters, scene)
    model = ForwardModel(scene, given)
    measured = _planes(model, data)
    known = _priors(model, priors or {})
    values = _coarse_track(model, measured, model.start)
    noise = _NoisePower.of(scene, measured)
    found, jacobian = model.derivative(values)
    difference = measured.astype(np.complex128) - found
    costs, damping, converged = [_energy(difference)], FIRST_DAMPING, False
    for step in range(1, iterations + 1):
        variance = noise.variance(difference)
        cost = _cost(difference, values, known, variance)
        normal, right = _normal_equations(jacobian, difference)
        for k, (mean, sigma) in known.items():  # in units of the data's variance
            normal[k, k] += 0.5 * variance / sigma**2
            right[k] += 0.5 * variance * (mean - values[k]) / sigma**2
        _check_determined(model.names, normal)
        for _ in range(ATTEMPTS):
            change: F64 = np.linalg.solve(normal + damping * np.diag(np.diag(normal)), right).astype(
                np.float64
            )
            tried = values + change
            left = measured.astype(np.complex128) - model.data(tried)
            new = _cost(left, tried, known, variance)
            if new < cost:
                break
            damping *= GROWS
        else:
            converged = True
            break
        damping *= FALLS
        follows = _follows(jacobian, change, difference - left, measured)
        values, difference, converged = tried, left, cost - new < LEAST_CHANGE * cost
        costs.append(_energy(difference))
        if progress is not None:
            progress(step, costs[-1])
        if converged or step == iterations:
            break
        if not follows:
            _, jacobian = model.derivative(values)
    normal, _ = _normal_equations(jacobian, difference)
    prior = np.zeros(len(values))
    for k, (_, sigma) in known.items():
        prior[k] = 1.0 / sigma**2
    shown = noise.of_power(max(float(np.mean(np.abs(difference) ** 2)), ROUNDING * noise.least))
    covariance = np.asarray(np.linalg.inv(2.0 * normal / shown + np.diag(prior)), dtype=np.float64)
    bound: F64 = np.full(len(values), np.nan)
    if noise.stated > 0.0:
        least = np.linalg.inv(2.0 * normal / noise.of_power(noise.stated) + np.diag(prior))
        bound = np.asarray(np.sqrt(np.diag(least)), dtype=np.float64)
    residual = replace(model.raw(difference.astype(np.complex64)), request=data.request)
    return Fit(
        model.names,
        model.start,
        values,
        covariance,
        bound,
        tuple(costs),
        converged,
        residual,
        model.at(values),
    )


def _planes(model: ForwardModel, data: RawData) -> C64:
    """Measured data (channels, pulses, samples), their layers of a channel summed."""
    name, radar = model.scene.name, model.scene.radar
    if data.domain != "compressed":
        raise DataError(
            f"{name}: raw data are {data.domain}; a fit takes range-compressed ones, as simulate() gives"
        )
    if set(data.channels) != set(radar.channels):
        raise DataError(
            f"{name}: raw data of channels {', '.join(data.channels)} and a radar of {', '.join(radar.channels)}; "
            "give the scene the polarisation of the data"
        )
    if data.data.shape[1:] != model.shape[1:]:
        raise DataError(
            f"{name}: raw data of {data.data.shape[1]} pulses of {data.data.shape[2]} samples, and a radar of "
            f"{model.shape[1]} of {model.shape[2]}; give the scene the radar of the data"
        )
    apart = float(np.abs(data.radar.window.start_range - radar.window.start_range).max())
    if apart > SAME_WINDOW:
        raise DataError(
            f"{name}: the receive windows of raw data and scene start up to {apart:.3g} m apart; give the scene the "
            "radar of the data"
        )
    out = np.zeros(model.shape, dtype=np.complex64)
    for plane, layer in zip(data.data, data.layers, strict=True):
        out[radar.channels.index(layer.channel)] += plane
    if not np.isfinite(out).all() or not out.any():
        raise DataError(f"{name}: the raw data are zero, or not finite: nothing can be fitted to them")
    return out


def _priors(model: ForwardModel, priors: Mapping[str, Prior]) -> dict[int, tuple[float, float]]:
    """Mean and standard deviation of the values with priors, by number."""
    short = [name.rsplit(" [", 1)[0] for name in model.names]
    known = {}
    for name, prior in priors.items():
        if name not in model.names and name not in short:
            raise SceneError(f"prior of {name!r}: no such parameter; there are {', '.join(model.names)}")
        if not prior.sigma > 0.0:
            raise SceneError(f"prior of {name!r}: sigma = {prior.sigma:g} must be above 0")
        number = model.names.index(name) if name in model.names else short.index(name)
        known[number] = (prior.mean, prior.sigma)
    return known


@dataclass(frozen=True)
class _NoisePower:
    """Noise of raw data: power of a sample as the radar states it, W (0: not stated), and least power that counts.

    ``samples`` : of a range cell, which are alike, as the noise is flat over the band alone
    """

    stated: float
    least: float
    samples: float

    @staticmethod
    def of(scene: Scene, measured: C64) -> _NoisePower:
        """Noise of a scene's radar; at least ``LEAST_NOISE`` of the measured power."""
        radar = scene.radar
        return _NoisePower(
            noise_power(radar, "compressed"),
            LEAST_NOISE * float(np.mean(np.abs(measured) ** 2)),
            max(float(radar.waveform.range_cell / radar.window.sample_spacing), 1.0),
        )

    def of_power(self, power: float) -> float:
        """Variance within the band, from the mean power of a sample."""
        return power * self.samples

    def variance(self, difference: C128) -> float:
        """Variance that priors are weighed against: as stated, else as the residuals show."""
        shown = max(float(np.mean(np.abs(difference) ** 2)), self.least)
        return self.of_power(self.stated if self.stated > 0.0 else shown)


def _energy(difference: C128) -> float:
    """Sum of squares."""
    return float(np.sum(np.abs(difference) ** 2))


def _cost(difference: C128, values: F64, known: Mapping[int, tuple[float, float]], variance: float) -> float:
    """Sum of squares of data and priors, in the data's unit."""
    prior = sum(float((values[k] - mean) / sigma) ** 2 for k, (mean, sigma) in known.items())
    return _energy(difference) + 0.5 * variance * prior


def _normal_equations(jacobian: C64, difference: C128) -> tuple[F64, F64]:
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


def _follows(jacobian: C64, change: F64, difference: C128, measured: C64) -> bool:
    """Whether the data changed by ``difference`` as the Jacobian predicts it for a change of the values."""
    predicted = np.tensordot(change.astype(np.float32), jacobian, 1)
    off = float(np.linalg.norm(difference - predicted))
    return off <= max(STRAIGHT * float(np.linalg.norm(predicted)), ROUNDED * float(np.linalg.norm(measured)))


def _check_determined(names: tuple[str, ...], normal: F64) -> None:
    """Refuse parameters on which the data do not depend, or of which they give only a sum."""
    own = np.diag(normal)
    for name, value in zip(names, own, strict=True):
        if not value > 0.0:
            raise SceneError(f"fit: the data do not depend on {name}; leave it out or give a prior")
    scaled = normal / np.sqrt(np.outer(own, own))
    weight, vectors = np.linalg.eigh(scaled)
    if weight[0] < LEAST_WEIGHT:
        worst = np.argsort(-np.abs(vectors[:, 0]))[:3]
        raise SceneError(
            f"fit: the data determine only sums of {', '.join(names[k] for k in sorted(worst))}; leave some out or "
            "give priors"
        )


def _coarse_track(model: ForwardModel, measured: C64, start: F64) -> F64:
    """Values with those of a track moved by the range errors of whole pulses; others stay."""
    tracks = [k for k, p in enumerate(model.parameters) if isinstance(p, AntennaTrack)]
    if not tracks:
        return start
    track = model.parameters[tracks[0]]
    assert isinstance(track, AntennaTrack)
    farther, lit = range_errors(model, measured, model.data(start))
    radar, time = model.scene.radar, model.scene.radar.track.time
    away = radar.track.position - model.sampling.window.center
    away /= np.linalg.norm(away, axis=1, keepdims=True)
    weights = track.weights(time)
    rows = np.concatenate([weights * away[:, "xyz".index(axis), None] for axis in track.axes], axis=1)
    rows, farther = rows[lit], farther[lit]
    small = ACROSS * np.eye(rows.shape[1])
    own = np.linalg.lstsq(
        np.concatenate([rows, small]), np.concatenate([farther, np.zeros(len(small))]), rcond=None
    )[0]
    split = model.split(start)
    split[tracks[0]] = split[tracks[0]] + own
    return np.concatenate(split)


def range_errors(model: ForwardModel, measured: C64, expected: C64) -> tuple[F64, NDArray[np.bool_]]:
    r"""Slant range by which the echoes of every pulse are farther than expected, m, and the pulses that have echoes.

    With the spectra D and M of measured and expected profiles over the band, the correlation of a pulse,
    :math:`\sum D M^* e^{j 4 \pi f r / c}` at the r where it is largest, has the phase
    :math:`-4 \pi f_c \Delta R / c`, unwrapped from pulse to pulse; the change of the phase over the band, common
    to all pulses once these are in phase, tells which multiple of half a wavelength is left. As the spectrum of speckle
    is uneven, both depend on r, which is what was found before.
    """
    radar = model.scene.radar
    n = measured.shape[-1]
    spectra = [np.fft.fft(x.astype(np.complex128), axis=-1) for x in (measured, expected)]
    cross = (spectra[0] * spectra[1].conj()).sum(axis=0)  # pulses, frequencies
    wavelength, spacing = radar.waveform.wavelength, radar.window.sample_spacing
    frequency = np.asarray(np.fft.fftfreq(n, d=2.0 * spacing / SPEED_OF_LIGHT), dtype=np.float64)
    order = np.argsort(frequency)

    def ramped(farther: F64) -> C128:
        return np.asarray(cross * np.exp(4j * np.pi * np.outer(farther, frequency) / SPEED_OF_LIGHT))

    largest = np.abs(np.fft.ifft(cross, axis=1)).argmax(axis=1)
    known: F64 = spacing * np.where(largest > n // 2, largest - n, largest)
    for _ in range(ROUNDS):
        total = ramped(known).sum(axis=1)
        lit = np.abs(total) > LIT * np.abs(total).max()
        phase = np.zeros(len(total))
        phase[lit] = np.unwrap(np.angle(total[lit]))
        farther = -phase * wavelength / (4.0 * np.pi)
        # all pulses in phase, and without the range errors known so far: what is left is common to all
        together = (ramped(farther) * np.exp(-1j * phase)[:, None])[lit].sum(axis=0)
        left = -_slope(together[order], frequency[order]) * SPEED_OF_LIGHT / (4.0 * np.pi)
        known = farther + left
    return farther + np.round(left / (0.5 * wavelength)) * 0.5 * wavelength, lit


def _slope(values: C128, at: F64) -> float:
    """Slope of a phase over equally spaced positions, weighted by the moduli; from short distances to long ones."""
    slope, lag = 0.0, max(1, len(values) // 32)
    while lag <= len(values) // 2:
        flat = values * np.exp(-1j * slope * at)
        slope += float(np.angle(np.sum(flat[lag:] * flat[:-lag].conj())) / (at[lag] - at[0]))
        lag *= 2
    return slope
