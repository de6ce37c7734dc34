"""Spatially varying surfaces: maps of level and material, and the gamma texture of clutter."""

from collections.abc import Mapping
from typing import ClassVar

import numpy as np
import scipy

from sarmitsuba.core.units import db_from_power
from sarmitsuba.effects.context import SceneContext
from sarmitsuba.effects.effect import EFFECTS, Assessment, Decision, Effect
from sarmitsuba.effects.flags import FlagValue
from sarmitsuba.effects.text import length, names
from sarmitsuba.scene.materials.diffuse import diffuse_tables
from sarmitsuba.scene.materials.material import Material

# angles at which the materials of a map are compared, 6 degrees apart
_NODES = 16


class SurfaceTexture(Effect):
    r"""Maps and textures; on where a material has one.

    For a factor f on sigma0 of unit mean the relative error of the field of a uniform surface of the same level is

    .. math:: \overline{(\sqrt f - 1)^2} = 2 - 2 \overline{\sqrt f}

    and :math:`\overline{\sqrt f} = \Gamma(\nu + 1/2) / (\Gamma(\nu) \sqrt\nu)` for a gamma texture.
    """

    name = "texture"
    title = "maps and texture of surfaces"
    documentation = (
        "maps of surfaces (level, permittivity, roughness, land cover) and the gamma texture of clutter"
    )
    off_when = "no material has a map or a texture"
    off_means = "uniform surfaces: no factor on the level, and of a map of materials the most frequent one"
    rank = 45
    kernel_flags: ClassVar[Mapping[str, str]] = {
        "texture": "level, texture and material at the position of every scatterer",
    }

    def assess(self, context: SceneContext, decided: Mapping[str, Decision]) -> Assessment:
        """See the class."""
        wavelength = context.scene.radar.waveform.wavelength
        shares: dict[str, float] = {}
        for m in context.materials:
            mapped = m.maps is not None and m.maps.classes is not None
            if m.texture_shape > 0.0 and not mapped:  # under a map the textures of its materials apply
                words = f"texture of shape {m.texture_shape:g} over {length(m.texture_length)} on {m.name}"
                shares[words] = _gamma_share(m.texture_shape)
            if m.maps is not None and m.maps.level is not None:
                shares[f"map of sigma0 on {m.name}"] = _level_share(np.asarray(m.maps.level.values))
            if m.maps is not None and m.maps.classes is not None:
                parts = m.maps.classes.materials
                shares[f"map of {len(parts)} materials on {m.name}"] = _parts_share(m, parts, wavelength)
        if not shares:
            return Assessment(False, "no material has a map or a texture", -np.inf)
        largest = max(shares.values())
        error = db_from_power(largest)
        return Assessment(True, names(list(shares)), error)

    def flags(
        self, on: bool, context: SceneContext, decided: Mapping[str, Decision]
    ) -> Mapping[str, FlagValue]:
        """Flag of maps and textures; false in scenes without any."""
        there = any(m.maps is not None or m.texture_shape > 0.0 for m in context.materials)
        return {"texture": on and there}


def _gamma_share(shape: float) -> float:
    return 2.0 - 2.0 * float(
        np.exp(scipy.special.gammaln(shape + 0.5) - scipy.special.gammaln(shape) - 0.5 * np.log(shape))
    )


def _level_share(factor: np.ndarray) -> float:
    """Relative error of a material without its map of sigma0, whose factor is 1."""
    return float(np.square(np.sqrt(factor) - 1.0).mean() / max(float(factor.mean()), 1e-30))


def _parts_share(own: Material, parts: tuple[Material, ...], wavelength: float) -> float:
    """Largest difference of a part's diffuse amplitude from that of the material, relative to the larger one."""
    tables = [diffuse_tables(m, wavelength, _NODES) for m in (own, *parts)]
    amplitude = np.stack([np.concatenate([t.amplitude_h, t.amplitude_v]) for t in tables])
    larger = np.maximum(np.maximum(amplitude[1:], amplitude[0]), 1e-15)
    return float(np.square((amplitude[1:] - amplitude[0]) / larger).max())


EFFECTS.register(SurfaceTexture())
