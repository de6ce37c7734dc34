"""Diffuse laws as tables: sqrt(sigma0) against incidence angle, one table for each material and wavelength.

The bistatic use of a table is ``sqrt(sigma0(theta_i, theta_s)) = sqrt(a(theta_i) a(theta_s))``, which is
reciprocal and returns the law itself in backscatter. ``h`` is the electric field perpendicular to the plane
of incidence, ``v`` the field parallel to it.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sarmitsuba.errors import ExtensionError, SceneError
from sarmitsuba.materials.diffuse_law import LAWS, Sigma0
from sarmitsuba.materials.material import Material

F64 = NDArray[np.float64]

# amplitudes of h and v that differ by less than this share are one, -60 dB
_SAME_AMPLITUDE = 1e-3


@dataclass(frozen=True, eq=False)
class DiffuseTable:
    """Amplitude of a diffuse law at equal steps of the incidence angle.

    Parameters
    ----------
    theta : (n,) float64, rad, ``linspace(0, pi/2, n)``: uniform in the angle, not in its cosine
    amplitude_h, amplitude_v : (n,) float64, sqrt(sigma0) for hh and vv, sigma0 per unit of true surface area
    valid_from, valid_to : incidence angles between which the law is trusted, rad (equal: nowhere)
    notes : one line for each limit that the material leaves, for a warning; empty inside the domain
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
    """Tabulate the diffuse law of a material at a wavelength.

    Parameters
    ----------
    material : with ``diffuse_law`` and the parameters that the law needs
    wavelength : m
    n_angles : number of nodes from 0 to pi/2

    Raises
    ------
    SceneError : a law from a height spectrum without a correlation length, or ``iem`` far outside any use
    ExtensionError : a law that returns something else than powers

    Notes
    -----
    Ignores cross polarisation (the material's ratio is applied by the tracer), shadowing by the roughness
    itself and the bistatic shape of the physical laws: off the backscatter direction the geometric mean of
    the two angles stands in for it, so a Kirchhoff lobe points back at the radar but never forward.
    """
    if n_angles < 2:
        raise SceneError(f"diffuse table: n_angles = {n_angles} is too few; give 2 or more")
    theta = np.linspace(0.0, np.pi / 2, n_angles)
    if material.invisible or (not material.pec and material.permittivity == 1.0):
        sigma0 = Sigma0.none(theta)
    else:
        sigma0 = LAWS[material.diffuse_law].sigma0(material, wavelength, theta)
        _check(material.diffuse_law, sigma0, theta)
    label = f'material "{material.name}": diffuse_law = {material.diffuse_law}: '
    return DiffuseTable(
        theta=theta,
        amplitude_h=np.sqrt(sigma0.h),
        amplitude_v=np.sqrt(sigma0.v),
        valid_from=sigma0.valid_from,
        valid_to=max(sigma0.valid_from, sigma0.valid_to),
        notes=tuple(label + note for note in sigma0.notes),
    )


def _check(law: str, sigma0: Sigma0, theta: F64) -> None:
    """Refuse what is no power before it reaches an image."""
    for values in (sigma0.h, sigma0.v):
        if values.shape != theta.shape or not (np.isfinite(values) & (values >= 0.0)).all():
            raise ExtensionError(
                f"diffuse law {law!r}: sigma0 must return {theta.size} finite values of at least 0 for hh and for vv"
            )


__all__ = ["DiffuseTable", "diffuse_tables"]
