"""Diffuse laws as tables: sqrt(sigma0) against incidence angle, one table for each material and wavelength.

``h`` is the electric field perpendicular to the plane of incidence, ``v`` the field parallel to it. The law between two
directions is in :attr:`sarmitsuba.scene.materials.diffuse_law.DiffuseLaw.bistatic`; laws of a height spectrum have a
second table for that.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, wraps
from typing import TypeVar

import numpy as np
from numpy.typing import ArrayLike

from sarmitsuba.core.arrays import F64
from sarmitsuba.core.errors import ExtensionError, SceneError
from sarmitsuba.scene.materials.diffuse_law import LAWS, Sigma0, WindWaves, permittivity_of
from sarmitsuba.scene.materials.material import Material
from sarmitsuba.scene.materials.rough_surface import bragg_factors

T = TypeVar("T")

# amplitudes of h and v that differ by less than this share count as equal, -60 dB
_SAME_AMPLITUDE = 1e-3
# nodes of a table of which only the range of validity and the notes are asked: they do not depend on the angle
FEW_ANGLES = 9


@dataclass(frozen=True, eq=False)
class DiffuseTable:
    """Amplitude of a diffuse law at equal steps of the incidence angle.

    Parameters
    ----------
    theta : (n,) float64, rad, ``linspace(0, pi/2, n)``: uniform in the angle, not in its cosine
    amplitude_h, amplitude_v : (n,) float64, sqrt(sigma0) for hh and vv, sigma0 per unit of true surface area
    valid_from, valid_to : range of validity of the law, incidence angles, rad (equal: nowhere)
    notes : one warning for each limit of validity that the material exceeds; empty inside the domain
    """

    theta: F64
    amplitude_h: F64
    amplitude_v: F64
    valid_from: float
    valid_to: float
    notes: tuple[str, ...] = ()

    def sigma0(self, theta: ArrayLike) -> tuple[F64, F64]:
        """Sigma0 (linear) for hh and vv at any angles, rad, by linear interpolation of the amplitude."""
        at = np.asarray(theta, dtype=np.float64)
        h = np.interp(at, self.theta, self.amplitude_h)
        v = np.interp(at, self.theta, self.amplitude_v)
        return np.asarray(h * h), np.asarray(v * v)

    @property
    def polarised(self) -> bool:
        """Whether hh and vv differ at any angle."""
        return not np.allclose(self.amplitude_h, self.amplitude_v, rtol=_SAME_AMPLITUDE)


def diffuse_tables(material: Material, wavelength: float, n_angles: int = 256) -> DiffuseTable:
    """Tables of the diffuse law of a material at a wavelength.

    Parameters
    ----------
    material : with ``diffuse_law`` and the parameters that the law needs
    wavelength : m
    n_angles : number of nodes from 0 to pi/2

    Raises
    ------
    SceneError : a law from a height spectrum without a correlation length, or ``iem`` far outside any use
    ExtensionError : a law that returns invalid powers

    Notes
    -----
    Ignores cross polarisation (the material's ratio is applied by the tracer) and shadowing by the roughness
    itself.
    """
    if n_angles < 2:
        raise SceneError(f"diffuse table: n_angles = {n_angles} is too few; give 2 or more")
    theta = np.linspace(0.0, np.pi / 2, n_angles)
    if not _returns(material):
        sigma0 = Sigma0.none(theta)
    else:
        sigma0 = _sigma0(material, wavelength, n_angles)
    label = f'material "{material.name}": diffuse_law = {material.diffuse_law}: '
    return DiffuseTable(
        theta=theta,
        amplitude_h=np.sqrt(sigma0.h),
        amplitude_v=np.sqrt(sigma0.v),
        valid_from=sigma0.valid_from,
        valid_to=max(sigma0.valid_from, sigma0.valid_to),
        notes=tuple(label + note for note in sigma0.notes),
    )


def _alike(make: Callable[..., T]) -> Callable[..., T]:
    """Cached function of a material's law, shared by materials that differ only in their name."""

    @lru_cache(maxsize=64)
    def made(_law: int, material: Material, *args: float) -> T:
        return make(material, *args)

    @wraps(make)
    def asked(material: Material, *args: float) -> T:
        if material.maps is None:
            try:
                return made(id(LAWS[material.diffuse_law]), replace(material, name=""), *args)
            except SceneError:
                pass  # given below, with the name
        return make(material, *args)

    return asked


@_alike
def _sigma0(material: Material, wavelength: float, n_angles: int) -> Sigma0:
    theta = np.linspace(0.0, np.pi / 2, n_angles)
    sigma0 = LAWS[material.diffuse_law].sigma0(material, wavelength, theta)
    _check(material.diffuse_law, sigma0, theta)
    return sigma0


@dataclass(frozen=True, eq=False)
class SpectrumTable:
    """Bistatic table of a law of a height spectrum.

    Parameters
    ----------
    amplitude : (n_cosine, n_sine) float64, square root of :meth:`DiffuseLaw.spectrum` at mean cosines uniform from
        0 to 1 and at sines ``linspace(0, 1, n_sine)**2``, dense about the mirror direction
    correction : (n_angles, 2) float64, h and v: fourth root of the law's backscatter over that of the spectrum
    """

    amplitude: F64
    correction: F64

    @property
    def corrected(self) -> bool:
        """Whether the law's backscatter differs from its spectrum's."""
        return not np.allclose(self.correction, 1.0, rtol=0.0, atol=_SAME_AMPLITUDE)


@_alike
def spectrum_table(
    material: Material, wavelength: float, n_cosine: int, n_sine: int, n_angles: int
) -> SpectrumTable:
    """Bistatic table of a law of a height spectrum.

    Parameters
    ----------
    material : whose law's ``bistatic`` is ``spectrum``
    wavelength : m
    n_cosine, n_sine, n_angles : nodes, see :class:`SpectrumTable`
    """
    sine, cosine = np.linspace(0.0, 1.0, n_sine) ** 2, np.linspace(0.0, 1.0, n_cosine)
    if not _returns(material):
        return SpectrumTable(np.zeros((n_cosine, n_sine)), np.ones((n_angles, 2)))
    law = LAWS[material.diffuse_law]
    amplitude = np.sqrt(law.spectrum(material, wavelength, sine, cosine))
    theta = np.linspace(0.0, np.pi / 2, n_angles)
    backscatter = law.sigma0(material, wavelength, theta)
    level = np.array([law.spectrum(material, wavelength, np.sin([t]), np.cos([t]))[0, 0] for t in theta])
    correction = np.ones((n_angles, 2))
    for i, (whole, factor) in enumerate(
        zip((backscatter.h, backscatter.v), bragg_factors(theta, permittivity_of(material)), strict=True)
    ):
        model = level * factor
        some = (model > _SAME_AMPLITUDE * model.max() * 1e-6) & (whole > 0.0)
        correction[some, i] = (whole[some] / model[some]) ** 0.25
    return SpectrumTable(amplitude, correction)


def water_in(materials: Sequence[Material], wavelength: float, seed: int) -> tuple[WindWaves, ...]:
    """Wind waves of the water materials; empty where there are none.

    Parameters
    ----------
    materials : with their laws
    wavelength : m
    seed : of the long waves
    """
    at = np.zeros(1)  # the level over the angle is not needed
    found = (LAWS[m.diffuse_law].wind_waves(m, wavelength, at, seed) for m in materials)
    return tuple(water for water in found if water is not None)


def _returns(material: Material) -> bool:
    """Whether the material has a surface that reflects."""
    return not material.invisible and (material.pec or material.permittivity != 1.0)


def _check(law: str, sigma0: Sigma0, theta: F64) -> None:
    """Raise an ExtensionError for invalid powers of a law."""
    for values in (sigma0.h, sigma0.v):
        if values.shape != theta.shape or not (np.isfinite(values) & (values >= 0.0)).all():
            raise ExtensionError(
                f"diffuse law {law!r}: sigma0 must return {theta.size} finite values of at least 0 for hh and for vv"
            )
