"""Effective-roughness laws: a share of the power reflected at the true angle and polarisation, in a stated pattern."""

import math
from typing import ClassVar

import numpy as np

from sarmitsuba.core.arrays import F64
from sarmitsuba.core.errors import SceneError
from sarmitsuba.core.parameters import Param
from sarmitsuba.core.units import power_from_db
from sarmitsuba.scene.materials.diffuse_law import (
    LAWS,
    Bistatic,
    DiffuseLaw,
    Sigma0,
    Surface,
    permittivity_of,
)
from sarmitsuba.scene.materials.fresnel import fresnel

_EXPONENT = Param(
    "lobe_exponent", "float", 4.0, "exponent alpha_R of the lobe about the mirror direction", "", 1.0, 200.0
)
_BACK_EXPONENT = Param(
    "back_lobe_exponent",
    "float",
    0.0,
    "exponent alpha_I of the lobe back to the source, beside that of lobe_exponent; 0: Lambert's law, no lobes",
    "",
    0.0,
    200.0,
)
_FORWARD = Param(
    "forward_share", "float", 0.5, "share Lambda of the lobe about the mirror direction in both", "", 0.0, 1.0
)


def lobe_power(theta: F64, exponent: int) -> F64:
    r"""Power over the hemisphere of a lobe ``((1 + cos psi) / 2)^alpha`` about a direction at an angle.

    .. math::
        F_\alpha(\theta) = 2^{-\alpha} \sum_{j=0}^{\alpha} \binom{\alpha}{j} I_j, \quad
        I_j = \frac{2 \pi}{j + 1} \begin{cases} 1 & j \text{ even} \\
        \cos\theta \sum_{w=0}^{(j-1)/2} \binom{2w}{w} \frac{\sin^{2w}\theta}{2^{2w}} & j \text{ odd} \end{cases}

    Parameters
    ----------
    theta : (n,) rad, of the direction from the normal
    exponent : alpha

    References
    ----------
    V. Degli-Esposti et al., IEEE Trans. AP 55 (1) 2007, 143-153: equations 13 to 16.
    """
    total, series = np.zeros_like(theta), np.zeros_like(theta)
    for j in range(exponent + 1):
        power = np.full_like(theta, 2.0 * np.pi / (j + 1))
        if j % 2:
            w = (j - 1) // 2
            series = series + math.comb(2 * w, w) * (0.5 * np.sin(theta)) ** (2 * w)
            power *= np.cos(theta) * series
        total += math.comb(exponent, j) * 0.5**exponent * power
    return total


class EffectiveRoughness(DiffuseLaw):
    r"""Backscatter of the effective-roughness model, for hh with the Fresnel coefficient of TE and for vv of TM.

    .. math::
        \sigma^0 = 4 \pi S^2 |R(\theta)|^2 \cos\theta f, \quad
        f = \frac{\cos\theta}{\pi} \text{ or }
        \frac{\Lambda \cos^{2 \alpha_R}\theta + 1 - \Lambda}{\Lambda F_{\alpha_R} + (1 - \Lambda) F_{\alpha_I}}

    Notes
    -----
    Reciprocal between two directions, by the mean of both angles; the model itself takes the incident wave's reflection
    coefficient there. Its lobe about the mirror direction is in backscatter only; `DirectiveRoughness` has it in all
    directions. Slabs reflect as half spaces.

    References
    ----------
    V. Degli-Esposti et al., IEEE Trans. AP 55 (1) 2007, 143-153; Sionna RT 2.2, class RadioMaterial.
    """

    name = "effective_roughness"
    title = "share of the power reflected at the true angle and polarisation, by Lambert's law or in lobes"
    level = "S^2, the share of the reflected power that is scattered"
    parameters: ClassVar[tuple[Param, ...]] = (_EXPONENT, _BACK_EXPONENT, _FORWARD)

    def sigma0(self, surface: Surface, wavelength: float, theta: F64) -> Sigma0:
        """See the class."""
        share = float(power_from_db(surface.diffuse_level_db))
        cosine = np.cos(theta)
        te, tm = fresnel(cosine, permittivity_of(surface))
        scattered = 4.0 * np.pi * share * cosine * self._pattern(surface, theta)
        notes = []
        if share > 1.0 + 1e-9:
            notes.append(
                f"diffuse_level_db = {surface.diffuse_level_db:g} dB scatters more than is reflected; give at most 0 dB"
            )
        return Sigma0(scattered * np.abs(te) ** 2, scattered * np.abs(tm) ** 2, notes=tuple(notes))

    def _pattern(self, surface: Surface, theta: F64) -> F64:
        """Backscattered power per solid angle over all that is scattered, (n,) float64."""
        forward = surface.law_parameter(_FORWARD.name)
        if surface.law_parameter(_BACK_EXPONENT.name) == 0.0:
            return np.asarray(np.cos(theta) / np.pi)
        ahead, back = (_whole(surface, parameter.name) for parameter in (_EXPONENT, _BACK_EXPONENT))
        lobes = forward * np.cos(theta) ** (2 * ahead) + 1.0 - forward
        return np.asarray(
            lobes / (forward * lobe_power(theta, ahead) + (1.0 - forward) * lobe_power(theta, back))
        )


class DirectiveRoughness(EffectiveRoughness):
    """The effective-roughness model with its lobe about the mirror direction, as of tilted facets."""

    name = "directive_roughness"
    title = "effective_roughness with a lobe about the mirror direction, also behind mirrors"
    parameters = (_EXPONENT,)
    bistatic: ClassVar[Bistatic] = "facets"

    def _pattern(self, surface: Surface, theta: F64) -> F64:
        exponent = _whole(surface, _EXPONENT.name)
        return np.asarray(np.cos(theta) ** (2 * exponent) / lobe_power(theta, exponent))


def _whole(surface: Surface, name: str) -> int:
    value = surface.law_parameter(name)
    if not value.is_integer():
        raise SceneError(f'material "{surface.name}": {name} = {value:g} is no whole number; give one')
    return int(value)


LAWS.register(EffectiveRoughness())
LAWS.register(DirectiveRoughness())
