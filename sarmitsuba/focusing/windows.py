"""Weighting functions over a band or an aperture, chosen by name."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sarmitsuba.errors import DataError

F64 = NDArray[np.float64]

WINDOW_NAMES = ("rectangular", "hamming", "hann", "taylor", "kaiser")

# name -> default parameters
_DEFAULTS: dict[str, tuple[float, ...]] = {
    "rectangular": (),
    "hamming": (0.54,),
    "hann": (),
    "taylor": (4.0, -35.0),
    "kaiser": (2.5,),
}


@dataclass(frozen=True)
class Window:
    r"""A symmetric weighting ``w(u)`` over ``|u| <= 1/2``, unity at the centre (Taylor: unit mean), zero outside.

    Parameters
    ----------
    name : one of ``WINDOW_NAMES``
    parameters : ``hamming``: pedestal coefficient; ``taylor``: n_bar and the peak sidelobe in dB (negative);
        ``kaiser``: beta
    """

    name: str
    parameters: tuple[float, ...] = ()

    def __call__(self, u: ArrayLike) -> F64:
        """Evaluate at ``u`` (any shape), where the band or aperture is ``-1/2 <= u <= 1/2``."""
        x = np.asarray(u, dtype=np.float64)
        weight = _FUNCTIONS[self.name](x, self.parameters)
        return np.where(np.abs(x) <= 0.5, weight, 0.0)

    def aperture(self, n: int) -> F64:
        """Weights of ``n`` samples that fill the aperture, (n,): sample i stands at ``u = (i + 1/2) / n - 1/2``."""
        return self((np.arange(n) + 0.5) / n - 0.5)

    @property
    def broadening(self) -> float:
        r"""Noise-equivalent width of the impulse response in cells, :math:`\int w^2 / (\int w)^2`."""
        w = self((np.arange(4096) + 0.5) / 4096 - 0.5)
        return float((w**2).mean() / w.mean() ** 2)

    def __str__(self) -> str:
        return ":".join([self.name, *(f"{p:g}" for p in self.parameters)])


def parse_window(text: str | Window) -> Window:
    """Read a window from its name and colon-separated parameters.

    ``rectangular``, ``hamming`` (``hamming:0.75``), ``hann``, ``taylor`` (``taylor:4:-35``: n_bar, sidelobe level in
    dB), ``kaiser`` (``kaiser:2.5``: beta).

    Raises
    ------
    DataError
        Unknown name, wrong number of parameters, or a parameter out of bounds.
    """
    if isinstance(text, Window):
        return text
    name, *rest = text.strip().lower().split(":")
    if name not in _DEFAULTS:
        raise DataError(f"window {text!r}: unknown; choose one of {', '.join(WINDOW_NAMES)}")
    default = _DEFAULTS[name]
    try:
        given = tuple(float(item) for item in rest)
    except ValueError:
        raise DataError(f"window {text!r}: parameters must be numbers, such as taylor:4:-35") from None
    if len(given) > len(default):
        raise DataError(f"window {text!r}: {name} takes at most {len(default)} parameters")
    parameters = given + default[len(given) :]
    _check(text, name, parameters)
    return Window(name, parameters)


def _check(text: str, name: str, parameters: tuple[float, ...]) -> None:
    if name == "hamming" and not 0.5 <= parameters[0] <= 1.0:
        raise DataError(f"window {text!r}: hamming coefficient must be within 0.5 .. 1")
    if name == "kaiser" and not 0.0 <= parameters[0] <= 40.0:
        raise DataError(f"window {text!r}: kaiser beta must be within 0 .. 40")
    if name == "taylor":
        n_bar, level = parameters
        if n_bar != int(n_bar) or not 2 <= n_bar <= 64:
            raise DataError(f"window {text!r}: taylor n_bar must be a whole number within 2 .. 64")
        if not -100.0 <= level <= -14.0:
            raise DataError(f"window {text!r}: taylor sidelobe level must be within -100 .. -14 dB")


def taylor_coefficients(n_bar: int, level_db: float) -> F64:
    r"""Coefficients :math:`F_m` of :math:`w(u) = 1 + 2 \sum_{m=1}^{\bar n - 1} F_m \cos 2 \pi m u`.

    References
    ----------
    Carrara, Goodman, Majewski, *Spotlight SAR*, appendix D.2 (sidelobe level ``level_db`` < 0).
    """
    a = np.arccosh(10.0 ** (-level_db / 20.0)) / np.pi
    s2 = n_bar**2 / (a**2 + (n_bar - 0.5) ** 2)
    m = np.arange(1, n_bar)
    out = np.empty(n_bar - 1)
    for i, mi in enumerate(m):
        top = np.prod(1.0 - mi**2 / s2 / (a**2 + (m - 0.5) ** 2))
        bottom = np.prod(1.0 - mi**2 / m[m != mi] ** 2)
        out[i] = 0.5 * (-1.0) ** (mi + 1) * top / bottom
    return out


def _rectangular(u: F64, _: tuple[float, ...]) -> F64:
    return np.ones_like(u)


def _hamming(u: F64, parameters: tuple[float, ...]) -> F64:
    a = parameters[0]
    return np.asarray(a + (1.0 - a) * np.cos(2.0 * np.pi * u))


def _hann(u: F64, _: tuple[float, ...]) -> F64:
    return np.asarray(0.5 + 0.5 * np.cos(2.0 * np.pi * u))


def _taylor(u: F64, parameters: tuple[float, ...]) -> F64:
    out = np.ones_like(u)
    for m, f in enumerate(taylor_coefficients(int(parameters[0]), parameters[1]), start=1):
        out += 2.0 * f * np.cos(2.0 * np.pi * m * u)
    return out


def _kaiser(u: F64, parameters: tuple[float, ...]) -> F64:
    beta = parameters[0]
    return np.asarray(np.i0(beta * np.sqrt(np.clip(1.0 - 4.0 * u**2, 0.0, None))) / np.i0(beta))


_FUNCTIONS: dict[str, Callable[[F64, tuple[float, ...]], F64]] = {
    "rectangular": _rectangular,
    "hamming": _hamming,
    "hann": _hann,
    "taylor": _taylor,
    "kaiser": _kaiser,
}

__all__ = ["WINDOW_NAMES", "Window", "parse_window", "taylor_coefficients"]
