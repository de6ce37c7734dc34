"""Reflection and transmission of a plane wave by a material that is a slab, in double precision."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from sarmitsuba.core.arrays import C128
from sarmitsuba.core.constants import VACUUM_IMPEDANCE
from sarmitsuba.scene.materials.fresnel import refracted_cosine
from sarmitsuba.scene.materials.material import Material

# sampled cosines of incidence, and the two-way power transmission below which a wall counts as opaque: below noise and
# side lobes of any receiver
COSINES = np.linspace(0.05, 1.0, 39)
OPAQUE = 1e-8


@dataclass(frozen=True, eq=False)
class SlabCoefficients:
    """Reflection and transmission coefficients of a slab.

    Parameters
    ----------
    r_te, r_tm : reflection at the illuminated face; of electric (TE) and magnetic fields (TM), so that a
        conductor gives -1 and +1
    t_te, t_tm : field behind the slab over that of the same wave without it
    """

    r_te: C128
    r_tm: C128
    t_te: C128
    t_tm: C128


def slab_coefficients(
    material: Material, wavelength: float, cos_theta: ArrayLike = COSINES
) -> SlabCoefficients:
    r"""Reflection and transmission coefficients of a slab in vacuum, its conducting sheet on the far face.

    From the matrix of a transmission line, with the electrical thickness :math:`\delta = k d q`, the normal wavenumber
    :math:`q = \sqrt{\varepsilon - \sin^2\theta}` and the sheet's admittance :math:`y = \eta_0 / R_s`,

    .. math::
        T_{TE} &= 2 c\, e^{j k d c} / D, & D &= 2 c \cos\delta + \tfrac{j \sin\delta}{q} (c^2 + q^2)
                  + y (\cos\delta + \tfrac{j \sin\delta}{q} c) \\
        R_{TE} D &= -(\varepsilon - 1) \tfrac{j \sin\delta}{q} - y (\cos\delta - \tfrac{j \sin\delta}{q} c)

    and for TM with :math:`c^2 + q^2 \to q^2 / \varepsilon + \varepsilon c^2`, the terms in y times c and with
    :math:`c \cos\delta` and :math:`\tfrac{j \sin\delta}{q} q^2 / \varepsilon` in them. All are scaled by
    :math:`e^{-j \delta}`, so that nothing overflows in a thick lossy wall.

    Parameters
    ----------
    material : permittivity at the wavelength, thickness and sheet resistance
    wavelength : m
    cos_theta : c, cosines of incidence, above 0 to 1, any shape

    Notes
    -----
    Ignores finite width and roughness. The kernel has the same formulas in single precision
    (``tracing/scatterers/slabs/slab_coefficients.py``);
    :mod:`sarmitsuba.truth.theory.slabs` sums the reflections between the faces and shares no code.

    References
    ----------
    Born and Wolf, Principles of Optics (1999), section 1.6.2, conjugated for exp(+j w t).
    """
    c, eps = np.asarray(cos_theta, dtype=np.float64), complex(material.permittivity)
    y = VACUUM_IMPEDANCE / material.sheet_resistance if material.sheet_resistance > 0.0 else 0.0
    thickness = 2.0 * np.pi * material.thickness / wavelength
    q = refracted_cosine(c, eps)
    delta = thickness * q
    once = np.exp(-1j * delta)
    twice = -np.expm1(-2j * delta)
    flat = q == 0.0  # the wave inside propagates along the slab
    cosine = 1.0 - 0.5 * twice
    sine_q = np.where(flat, 1j * thickness, 0.5 * twice / np.where(flat, 1.0, q))
    inner, outer = q * q / eps, eps * c * c
    free = 2.0 * c * once * np.exp(1j * thickness * c)
    d_te = 2.0 * c * cosine + sine_q * (c * c + q * q) + y * (cosine + sine_q * c)
    d_tm = 2.0 * c * cosine + sine_q * (inner + outer) + y * c * (c * cosine + sine_q * inner)
    r_te = (1.0 - eps) * sine_q - y * (cosine - sine_q * c)
    contrast = (eps - 1.0) * ((1.0 + eps) * c * c - 1.0) / eps
    r_tm = contrast * sine_q + y * c * (c * cosine - sine_q * inner)
    return SlabCoefficients(
        np.asarray(r_te / d_te), np.asarray(r_tm / d_tm), np.asarray(free / d_te), np.asarray(free / d_tm)
    )


def through(material: Material, wavelength: float, cos_theta: ArrayLike = COSINES) -> tuple[C128, C128]:
    """Transmission coefficients TE and TM of a slab at cosines of incidence; zero for a half space."""
    cosines = np.asarray(cos_theta, dtype=np.float64)
    if material.thickness <= 0.0 or material.pec:
        none = np.zeros(cosines.shape, dtype=np.complex128)
        return none, none
    found = slab_coefficients(material, wavelength, cosines)
    return found.t_te, found.t_tm


def most_power_through(material: Material, wavelength: float, cos_theta: ArrayLike = COSINES) -> float:
    """Largest two-way power transmission over all angles."""
    return float(max(np.abs(t).max() for t in through(material, wavelength, cos_theta)) ** 4)


def lets_through(material: Material, wavelength: float) -> bool:
    """Whether the material is transparent: scatterers behind it can be visible."""
    return not material.invisible and most_power_through(material, wavelength) > OPAQUE
