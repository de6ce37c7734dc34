"""Interface of diffuse laws; each law is one file in ``materials/laws``."""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import ClassVar, Literal, Protocol

import numpy as np

from sarmitsuba.core.arrays import F64
from sarmitsuba.core.errors import SceneError
from sarmitsuba.core.parameters import Param
from sarmitsuba.core.registry import Registry

# kinds of bistatic scattering of a law, see `DiffuseLaw.bistatic`
Bistatic = Literal["mean", "facets", "spectrum"]

# permittivity that represents a perfect conductor where a formula needs a number: |R| = 1 to 1e-6
_CONDUCTOR = 1.0 - 1.0e12j


class Surface(Protocol):
    """Properties of a material that a law may use; see :class:`sarmitsuba.scene.materials.material.Material`."""

    @property
    def name(self) -> str:
        """Name, unique in a scene."""

    @property
    def pec(self) -> bool:
        """Perfect electric conductor."""

    @property
    def permittivity(self) -> complex:
        """Relative, ``eps' - j eps''``."""

    @property
    def rms_height(self) -> float:
        """Standard deviation of the surface height, m."""

    @property
    def correlation_length(self) -> float:
        """Of the surface height, m."""

    @property
    def diffuse_level_db(self) -> float:
        """Level of an empirical law, dB; its meaning depends on the law."""

    def law_parameter(self, name: str) -> float:
        """Value of a parameter of the law."""


@dataclass(frozen=True, eq=False)
class Sigma0:
    """Backscatter of a law over the incidence angle, with its domain of validity.

    Parameters
    ----------
    h, v : (n,) float64, sigma0 (linear) for hh and vv, per unit of true surface area
    valid_from, valid_to : rad; range of validity of the law, incidence angles (equal: nowhere)
    notes : one line for each limit of the law that the material leaves, each with its remedy
    """

    h: F64
    v: F64
    valid_from: float = 0.0
    valid_to: float = np.pi / 2
    notes: tuple[str, ...] = ()

    @staticmethod
    def none(theta: F64) -> "Sigma0":
        """No diffuse return."""
        return Sigma0(np.zeros_like(theta), np.zeros_like(theta))


@dataclass(frozen=True, eq=False)
class WindWaves:
    """Wind effects on a water surface: azimuthal modulation, velocities and long waves.

    Parameters
    ----------
    downwind : (2,) unit vector, east and north, towards which the wind blows
    contrast : (n, 4) float64 at the incidence angles of the table: harmonics of twice the angle between look and wind
        for hh and vv, then of four times, over the mean of all directions
    speeds : (3,) m/s, standard deviations of the velocity of a scatterer: downwind, crosswind, upwards
    waves : (n, 5) float64, long waves drawn one by one: wavenumber east and north (rad/m), angular frequency (rad/s),
        phase (rad) and amplitude (m)
    """

    downwind: F64
    contrast: F64
    speeds: F64
    waves: F64


class DiffuseLaw(ABC):
    """Diffuse law: incoherent return of a surface over angle and polarisation.

    Whether hh and vv differ follows from the numbers, and is not declared.

    Attributes
    ----------
    name : value of ``diffuse_law`` in the scene file
    title : half a line for tables
    level : quantity of ``diffuse_level_db`` for this law; empty: the law has none
    needs : material fields (``rms_height``, ``correlation_length``) that must be above 0 in a scene file
    parameters : parameters of the law (of the kind ``float``, with a default), accepted by ``radar_material``
    bistatic : extension of the law to two directions, all three reciprocal and equal to the law in backscatter.
        ``mean``: the geometric mean of its backscatter at both angles, each in its plane of incidence.
        ``facets``: tilted facets; the level at the angle of the half vector, which is the normal of the facet that
        mirrors one direction into the other, times that facet's Fresnel coefficients over those at normal incidence.
        ``spectrum``: `spectrum` times the polarisation factors of first-order perturbation theory
    scatters : False for the law without diffuse return
    temporal_coherence : between passes, default for a material that states none
    blocks_as_vacuum : a material of permittivity 1 with this law still blocks rays; False: it is empty space
    """

    name: ClassVar[str]
    title: ClassVar[str]
    level: ClassVar[str] = ""
    needs: ClassVar[tuple[str, ...]] = ()
    parameters: ClassVar[tuple[Param, ...]] = ()
    bistatic: ClassVar[Bistatic] = "mean"
    scatters: ClassVar[bool] = True
    temporal_coherence: ClassVar[float] = 1.0
    blocks_as_vacuum: ClassVar[bool] = True

    @abstractmethod
    def sigma0(self, surface: Surface, wavelength: float, theta: F64) -> Sigma0:
        """Backscatter of a surface.

        Parameters
        ----------
        surface : never of permittivity 1, which has no return with any law
        wavelength : m
        theta : (n,) float64, rad, equally spaced from 0 to pi/2

        Raises
        ------
        SceneError : a material to which the law does not apply
        """

    def implied_rms_height(self, surface: Surface) -> float:
        """Default rms height of a surface without one, m."""
        return 0.0

    def wind_waves(self, surface: Surface, wavelength: float, theta: F64, seed: int) -> WindWaves | None:
        """Wind effects, for laws of water; None for laws without motion or direction.

        Parameters
        ----------
        surface, wavelength, theta : as for `sigma0`, whose level is the mean over all wind directions
        seed : of the waves
        """
        return None

    def spectrum(self, surface: Surface, wavelength: float, sine: F64, cosine: F64) -> F64:
        r"""For laws whose ``bistatic`` is ``spectrum``: sigma0 over ``|cos_i cos_s alpha|^2`` of first-order theory.

        Parameters
        ----------
        surface, wavelength : as for `sigma0`
        sine : (n,) wavenumber of the surface that couples the two directions, over 2 k: \|k_s - k_i\| / 2k in the plane
        cosine : (m,) mean cosine of both angles, 0 to 1

        Returns
        -------
        (m, n) float64, of at least 0
        """
        raise NotImplementedError(
            f"diffuse law {self.name!r} says bistatic = {self.bistatic!r} without a spectrum"
        )


LAWS: Registry[DiffuseLaw] = Registry("diffuse law", DiffuseLaw, "sarmitsuba.scene.materials.laws")


def law_parameters() -> tuple[Param, ...]:
    """Parameters of the registered laws; laws may share one."""
    return tuple(sorted({p for law in LAWS for p in law.parameters}, key=lambda p: p.name))


def permittivity_of(surface: Surface) -> complex:
    """Permittivity for formulas that need a number: a perfect conductor's is large, not infinite."""
    return _CONDUCTOR if surface.pec else surface.permittivity


def correlation_length_of(surface: Surface, law: str) -> float:
    """Correlation length, m.

    Raises
    ------
    SceneError : it is not above 0
    """
    if not surface.correlation_length > 0.0:
        raise SceneError(
            f'material "{surface.name}": correlation_length = {surface.correlation_length:g} m must be '
            f"above 0 for diffuse_law = {law}; give the correlation length of the surface height"
        )
    return surface.correlation_length
