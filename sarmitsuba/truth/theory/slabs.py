r"""Reflection and transmission of a plane wave by a slab, with or without a thin conducting sheet on one face.

The slab alone is the multiple-reflection sum of ITU-R P.2040-3; a sheet is joined to it by the reflections between
the two, each known by itself. The package's coefficients come from transmission-line matrices; nothing is shared.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from sarmitsuba.core.arrays import C128, F64
from sarmitsuba.core.constants import VACUUM_IMPEDANCE
from sarmitsuba.truth.theory.half_space import fresnel, normal_wavenumber


@dataclass(frozen=True, eq=False)
class SlabWaves:
    """Waves on both sides of a slab over the incident one.

    Parameters
    ----------
    r_te, r_tm : reflection at the face that the wave meets; of electric (TE) and magnetic fields (TM), so that a
        conductor gives -1 and +1
    t_te, t_tm : transmission, from the face that the wave meets to the point of the other face straight behind it
    """

    r_te: C128
    r_tm: C128
    t_te: C128
    t_tm: C128


def slab(
    cos_theta: ArrayLike,
    permittivity: complex | ArrayLike,
    thickness: float,
    wavelength: float,
    sheet_resistance: float = 0.0,
    *,
    sheet_first: bool = False,
) -> SlabWaves:
    r"""Return the coefficients of a slab in vacuum.

    .. math::
        R = \frac{r (1 - e^{-2 j \delta})}{1 - r^2 e^{-2 j \delta}}, \quad
        T = \frac{(1 - r^2) e^{-j \delta}}{1 - r^2 e^{-2 j \delta}}, \quad
        \delta = \frac{2 \pi d}{\lambda} \sqrt{\varepsilon - \sin^2\theta}

    with r of the half space. A sheet of resistance :math:`R_s` per square that lies against the slab scatters by
    itself :math:`\rho = -y / (2 Y + y)`, :math:`\tau = 1 + \rho`, with :math:`y = \eta_0 / R_s` and Y the wave's
    admittance, :math:`\cos\theta` (TE) or :math:`1 / \cos\theta` (TM).

    Parameters
    ----------
    cos_theta : cosine of the incidence angle, above 0 to 1
    permittivity : relative, eps' - j eps''
    thickness, wavelength : m
    sheet_resistance : ohm per square; 0: no sheet
    sheet_first : the wave meets the sheet before the slab, else behind it

    Notes
    -----
    Ignores finite width and roughness. The sheet is far thinner than a wavelength and than its skin depth.

    References
    ----------
    ITU-R P.2040-3 (2023), section 2.2.2.2, single-layer slab; Born and Wolf, Principles of Optics (1999), section 7.6.
    """
    c, eps = np.broadcast_arrays(
        np.asarray(cos_theta, dtype=np.float64), np.asarray(permittivity, dtype=np.complex128)
    )
    delta = 2.0 * np.pi * thickness / wavelength * normal_wavenumber(c, eps)
    te, tm = fresnel(c, eps)
    waves = []
    # by the ratio of tangential electric fields, which turns the sign of TM
    for half_space, admittance in ((te, c), (-tm, 1.0 / c)):
        r, t = _airy(half_space, delta)
        if sheet_resistance > 0.0:
            y = VACUUM_IMPEDANCE / sheet_resistance
            rho = -y / (2.0 * admittance + y)
            sheet = np.asarray(rho, np.complex128), np.asarray(1.0 + rho, np.complex128)
            r, t = _join_layers(sheet, (r, t)) if sheet_first else _join_layers((r, t), sheet)
        waves.append((r, t))
    (r_te, t_te), (r_tm, t_tm) = waves
    return SlabWaves(r_te, -r_tm, t_te, t_tm)


def slab_insertion(
    cos_theta: ArrayLike,
    permittivity: complex,
    thickness: float,
    wavelength: float,
    sheet_resistance: float = 0.0,
) -> tuple[C128, C128]:
    r"""Return the insertion transmission of a slab: field behind it over that without it, TE and TM.

    .. math:: T\, e^{+j k d \cos\theta}
    """
    waves = slab(cos_theta, permittivity, thickness, wavelength, sheet_resistance)
    free = np.exp(2j * np.pi * thickness / wavelength * np.asarray(cos_theta, dtype=np.float64))
    return np.asarray(waves.t_te * free), np.asarray(waves.t_tm * free)


def slab_delay(
    cos_theta: ArrayLike,
    permittivity: complex,
    thickness: float,
    wavelength: float,
    sheet_resistance: float = 0.0,
) -> tuple[F64, F64]:
    r"""Return the one-way group delay of a pulse in a slab as an additional path, TE and TM, m.

    .. math:: \Delta L = -\frac{\partial}{\partial k} \arg (T e^{+j k d \cos\theta})

    by a difference of phases over a millionth of the wavenumber; the permittivity is that of one frequency.
    """
    step = 1e-6
    low, high = (
        slab_insertion(cos_theta, permittivity, thickness, wavelength / (1.0 + s), sheet_resistance)
        for s in (-step, step)
    )
    span = 2.0 * step * 2.0 * np.pi / wavelength
    te, tm = (-np.angle(b / a) / span for a, b in zip(low, high, strict=True))
    return np.asarray(te), np.asarray(tm)


def slab_shift(
    cos_theta: ArrayLike,
    permittivity: complex,
    thickness: float,
    wavelength: float,
    sheet_resistance: float = 0.0,
) -> tuple[F64, F64]:
    r"""Return the lateral displacement of a wave by a slab, positive towards the normal, TE and TM, m.

    .. math:: \frac{\partial P}{\partial \theta}, \quad P = -\frac1k \arg (T e^{+j k d \cos\theta})

    which is :math:`d \sin\theta (1 - \cos\theta / q)` without reflections at the faces; by a difference over a
    millionth of a radian.
    """
    theta, step = np.arccos(np.asarray(cos_theta, dtype=np.float64)), 1e-6
    low, high = (
        slab_insertion(np.cos(theta + s), permittivity, thickness, wavelength, sheet_resistance)
        for s in (-step, step)
    )
    span = 2.0 * step * 2.0 * np.pi / wavelength
    te, tm = (-np.angle(b / a) / span for a, b in zip(low, high, strict=True))
    return np.asarray(te), np.asarray(tm)


def layers_insertion(
    cos_theta: float, layers: Sequence[tuple[complex, float]], wavelength: float
) -> tuple[complex, complex]:
    r"""Return the insertion transmission of plane layers: field behind them over that without them, TE and TM.

    From the product of the layers' characteristic matrices of tangential fields,

    .. math:: M = \prod_i \begin{pmatrix} \cos\delta_i & j \sin\delta_i / Y_i \\
              j Y_i \sin\delta_i & \cos\delta_i \end{pmatrix}, \quad
              T = \frac{2 Y_0 e^{j k D \cos\theta}}{Y_0 M_{11} + Y_0^2 M_{12} + M_{21} + Y_0 M_{22}}

    with admittances :math:`Y = q` (TE) and :math:`\varepsilon / q` (TM) over that of free space.

    Parameters
    ----------
    cos_theta : cosine of the incidence angle
    layers : permittivity eps' - j eps'' and thickness (m) of each, in the order in which the wave meets them; air
        between panes is one of them
    wavelength : m

    Notes
    -----
    Ignores finite width and roughness.

    References
    ----------
    Born and Wolf, Principles of Optics (1999), section 1.6.2, conjugated for exp(+j w t).
    """
    found = []
    for te in (True, False):
        outer = complex(cos_theta) if te else 1.0 / complex(cos_theta)
        whole = np.eye(2, dtype=np.complex128)
        for permittivity, thickness in layers:
            q = complex(
                normal_wavenumber(np.asarray(cos_theta), np.asarray(permittivity, dtype=np.complex128))
            )
            y = q if te else permittivity / q
            delta = 2.0 * np.pi / wavelength * thickness * q
            whole = whole @ np.array(
                [[np.cos(delta), 1j * np.sin(delta) / y], [1j * y * np.sin(delta), np.cos(delta)]]
            )
        total = outer * (whole[0, 0] + whole[1, 1]) + outer**2 * whole[0, 1] + whole[1, 0]
        free = np.exp(2j * np.pi / wavelength * sum(t for _, t in layers) * cos_theta)
        found.append(complex(2.0 * outer * free / total))
    return found[0], found[1]


def _airy(r: C128, delta: C128) -> tuple[C128, C128]:
    """Sum of all reflections between the two faces of a slab."""
    once = np.exp(-1j * delta)
    rest = 1.0 - r * r * once * once
    return np.asarray(r * (1.0 - once * once) / rest), np.asarray((1.0 - r * r) * once / rest)


def _join_layers(first: tuple[C128, C128], second: tuple[C128, C128]) -> tuple[C128, C128]:
    """Sum of all reflections between two adjacent symmetric layers, in the order of incidence."""
    rest = 1.0 - first[0] * second[0]
    return (
        np.asarray(first[0] + first[1] ** 2 * second[0] / rest),
        np.asarray(first[1] * second[1] / rest),
    )
