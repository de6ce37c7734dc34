"""Quantisation of Gaussian echoes: uniform and Lloyd-Max quantisers, block-adaptive quantisation (BAQ, FDBAQ).

I and Q of each sample are quantised apart. Echoes of many scatterers are circular Gaussian, so quantisers are those of
least mean square error for a Gaussian of unit variance, scaled by the rms of the record or of a block.

References
----------
Max, IRE Trans. Inf. Theory 6 (1) 1960, tables I and II; Kwok and Johnson, IEEE TGRS 27 (4) 1989 (BAQ); Attema et al.,
Proc. EUSAR 2010 (FDBAQ).
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import scipy
from numpy.typing import NDArray

from sarmitsuba.core.arrays import C64, F32, F64, U8
from sarmitsuba.core.errors import DataError

MOST_BITS = 8
# rates among which FDBAQ chooses, bits per I and per Q
FDBAQ_BITS = (2, 3, 4)
# Newton steps from the companding solution; six suffice
_ITERATIONS = 20


def _density(x: F64) -> F64:
    return np.asarray(np.exp(-0.5 * x * x) / np.sqrt(2.0 * np.pi))


@dataclass(frozen=True, eq=False)
class Quantiser:
    """Quantiser of a Gaussian of mean 0 and variance 1.

    Parameters
    ----------
    thresholds : (n - 1,) float64, ascending
    levels : (n,) float64, ascending; values between two thresholds are replaced by the level there
    """

    thresholds: F64
    levels: F64

    @property
    def distortion(self) -> float:
        r"""Mean square error :math:`E (x - q(x))^2` for the Gaussian.

        Sum over the cells of the integrals of ``(x - y)^2`` with the density, from its primitive.
        """
        edges = np.concatenate([[-np.inf], self.thresholds, [np.inf]])
        bare = np.where(np.isfinite(edges), edges, 0.0)
        share = np.diff(scipy.special.ndtr(edges))
        first = -np.diff(_density(bare) * np.isfinite(edges))
        second = share - np.diff(bare * _density(bare))
        y = self.levels
        return float(np.sum(second - 2.0 * y * first + y * y * share))

    @property
    def gain(self) -> float:
        """Regression :math:`E x q(x)` of the output on the input: below 1 where the quantiser shrinks echoes."""
        edges = np.concatenate([[-np.inf], self.thresholds, [np.inf]])
        density = np.where(np.isfinite(edges), _density(np.where(np.isfinite(edges), edges, 0.0)), 0.0)
        return float(-np.sum(self.levels * np.diff(density)))

    @property
    def sqnr(self) -> float:
        """Ratio of the signal to the quantisation noise, ``1 / distortion``, power."""
        return 1.0 / self.distortion

    def quantise(self, values: NDArray[np.floating]) -> F32:
        """Values of unit variance, quantised."""
        return np.asarray(self.levels.astype(np.float32)[np.searchsorted(self.thresholds, values)])


def _check_bits(bits: int) -> None:
    if not 1 <= bits <= MOST_BITS:
        raise DataError(f"quantiser: {bits} bits; give 1 to {MOST_BITS}")


@lru_cache
def uniform_quantiser(bits: int) -> Quantiser:
    """Uniform midrise quantiser of the step with the least error for a Gaussian (Max 1960, table II)."""
    _check_bits(bits)
    half = 2 ** (bits - 1)

    def of(step: float) -> Quantiser:
        return Quantiser(step * np.arange(1 - half, half), step * (np.arange(-half, half) + 0.5))

    # the error has one minimum; full scale is between 1 and 5 rms for 1 to 8 bits
    found = scipy.optimize.minimize_scalar(
        lambda step: of(float(step)).distortion,
        bounds=(1.0 / half, 6.0 / half),
        method="bounded",
        options={"xatol": 1e-10},
    )
    return of(float(found.x))


@lru_cache
def lloyd_max_quantiser(bits: int) -> Quantiser:
    """Quantiser of the least error for a Gaussian (Max 1960, table I): each level is the mean of its cell."""
    _check_bits(bits)
    n = 2**bits
    # companding: the density of levels goes with the cube root of the signal's
    levels = np.sqrt(3.0) * scipy.special.ndtri((np.arange(n) + 0.5) / n)
    for _ in range(_ITERATIONS):
        inner = 0.5 * (levels[1:] + levels[:-1])
        edges = np.concatenate([[-np.inf], inner, [np.inf]])
        density = np.concatenate([[0.0], _density(inner), [0.0]])
        share = np.diff(scipy.special.ndtr(edges))
        mean = -np.diff(density) / share
        # Newton's step: the mean of a cell moves with its two thresholds, which are halfway between levels
        lower = 0.5 * density[1:-1] * (mean[1:] - inner) / share[1:]
        upper = 0.5 * density[1:-1] * (inner - mean[:-1]) / share[:-1]
        slope = np.diag(lower, -1) + np.diag(upper, 1)
        slope += np.diag(np.concatenate([[0.0], lower]) + np.concatenate([upper, [0.0]]))
        change = np.linalg.solve(np.eye(n) - slope, mean - levels)
        levels = levels + change
        if np.abs(change).max() < 1e-12:
            break
    levels = 0.5 * (levels - levels[::-1])  # symmetric to the last bit
    return Quantiser(0.5 * (levels[1:] + levels[:-1]), levels)


def clipping_distortion(level: float) -> tuple[float, float]:
    r"""Gain and distortion of a Gaussian of unit variance that is clipped at :math:`\pm c`.

    .. math:: \alpha = \operatorname{erf}(c / \sqrt 2), \quad
              d = 1 - 2 c \phi(c) - (1 - c^2) \, 2 Q(c) - \alpha^2

    with the density :math:`\phi` and the tail :math:`Q`. The output is :math:`\alpha x` and noise of variance d that
    is uncorrelated with x (Bussgang).

    Parameters
    ----------
    level : c, over the rms
    """
    alpha = float(scipy.special.erf(level / np.sqrt(2.0)))
    density = float(_density(np.asarray(level)))
    power = alpha - 2.0 * level * density + level**2 * (1.0 - alpha)
    return alpha, power - alpha**2


def quantise_uniform(data: C64, rms: float, bits: int) -> C64:
    """Echoes (..., n) of an analogue-to-digital converter; ``rms``: of I and of Q, for which its steps are made."""
    if not rms > 0.0:
        return data
    return _quantise(data, np.full((1,) * data.ndim, rms, dtype=np.float32), uniform_quantiser(bits))


def quantise_blocks(data: C64, block: int, bits: int) -> C64:
    """Echoes (n_pulses, n) after block-adaptive quantisation with Lloyd-Max quantisers.

    Parameters
    ----------
    block : samples of one pulse that share a scale, the rms of their I and Q
    bits : per I and per Q, 1 to 8

    Notes
    -----
    Ignores the rounding of the transmitted scales.
    """
    return _unblock(_quantise(*_blocks(data, block), lloyd_max_quantiser(bits)), data)


def quantise_flexibly(data: C64, block: int, noise_power: float, margin: float) -> tuple[C64, U8]:
    """Echoes (n_pulses, n) after FDBAQ: each block has the fewest bits that its own quantisation noise allows.

    Parameters
    ----------
    block : samples of one pulse that share scale and rate
    noise_power : thermal noise of one sample
    margin : the quantisation noise is at most the thermal noise over this, where 4 bits are enough

    Returns
    -------
    echoes, and (n_pulses, n_blocks) bits per I and per Q

    Notes
    -----
    Sentinel-1 chooses its rate by the signal-to-noise ratio too; its quantisers are uniform with entropy coding.
    """
    pieces, rms = _blocks(data, block)
    power = 2.0 * np.square(rms[..., 0], dtype=np.float64)
    bits = np.full(power.shape, FDBAQ_BITS[-1], dtype=np.uint8)
    for rate in reversed(FDBAQ_BITS[:-1]):
        bits[power / lloyd_max_quantiser(rate).sqnr <= noise_power / margin] = rate
    out = np.empty_like(pieces)
    for rate in FDBAQ_BITS:
        pick = bits == rate
        out[pick] = _quantise(pieces[pick], rms[pick], lloyd_max_quantiser(rate))
    return _unblock(out, data), bits


def _blocks(data: C64, block: int) -> tuple[C64, F32]:
    """Blocks (n_pulses, n_blocks, block), the last filled with zeros, and the rms of I and Q of each."""
    n_pulses, n = data.shape
    n_blocks = -(-n // block)
    padded = np.zeros((n_pulses, n_blocks * block), dtype=np.complex64)
    padded[:, :n] = data
    pieces = padded.reshape(n_pulses, n_blocks, block)
    filled = np.full(n_blocks, block)
    filled[-1] = n - (n_blocks - 1) * block
    energy = np.square(np.abs(pieces), dtype=np.float64).sum(axis=2)
    return pieces, np.sqrt(0.5 * energy / filled).astype(np.float32)[..., None]


def _unblock(pieces: C64, data: C64) -> C64:
    return np.ascontiguousarray(pieces.reshape(data.shape[0], -1)[:, : data.shape[1]])


def _quantise(data: C64, rms: F32, quantiser: Quantiser) -> C64:
    """Data over their rms (broadcasts), quantised in I and Q; where the rms is 0, so are the data."""
    scaled = np.asarray(data / np.where(rms > 0.0, rms, np.float32(1.0)), dtype=np.complex64)
    out = np.empty_like(scaled)
    out.real, out.imag = quantiser.quantise(scaled.real), quantiser.quantise(scaled.imag)
    return np.asarray(out * rms)
