"""Additional materials from maps: classes, and steps of permittivity and roughness bitmaps."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from sarmitsuba.core.arrays import F64, I64
from sarmitsuba.core.errors import SceneError
from sarmitsuba.scene.materials.material import Material

# number of materials per permittivity or roughness map: a single map, and each of two
MOST_LEVELS, MOST_LEVELS_OF_TWO = 64, 24


def list_with_parts(materials: Sequence[Material]) -> tuple[Material, ...]:
    """Materials followed by the additional ones of their maps, in the order of the kernel's tables."""
    parts = [
        p
        for m in materials
        if m.maps is not None and m.maps.classes is not None
        for p in m.maps.classes.materials
    ]
    return (*materials, *parts)


def map_attributes(material: Material) -> tuple[str, ...]:
    """Mesh attributes used by a material's maps."""
    maps = material.maps
    bitmaps = [] if maps is None else [maps.level, None if maps.classes is None else maps.classes.bitmap]
    return tuple(name for b in bitmaps if b is not None for name in b.placement.attributes)


def vary_material(
    material: Material, permittivity: F64 | None, rms_height: F64 | None
) -> tuple[I64, tuple[Material, ...]]:
    """Materials for every pair of values of two bitmaps: index of the material per texel, and the materials.

    Parameters
    ----------
    material : common properties; its loss tangent is kept with every permittivity, its correlation length with
        every roughness
    permittivity : real parts; None: the material's
    rms_height : m; None: the material's

    Raises
    ------
    SceneError : a value is invalid for a material, or the bitmaps differ in shape

    Notes
    -----
    Up to ``MOST_LEVELS`` different values are exact (``MOST_LEVELS_OF_TWO`` each where there are two bitmaps); more are
    rounded to so many steps, equal in dB, between the least and the largest.
    """
    label = f'material "{material.name}"'
    if permittivity is not None and rms_height is not None and permittivity.shape != rms_height.shape:
        raise SceneError(
            f"{label}: permittivity_map has {permittivity.shape} texels and roughness_map {rms_height.shape}; give "
            "both the same size"
        )
    if permittivity is not None and (material.pec or not (permittivity >= 1.0).all()):
        what = (
            "of a perfect conductor has no effect"
            if material.pec
            else f"goes down to {permittivity.min():g}, below 1"
        )
        raise SceneError(f"{label}: permittivity_map {what}; change the map or its range")
    if rms_height is not None and not (rms_height >= 0.0).all():
        raise SceneError(
            f"{label}: roughness_map goes down to {rms_height.min():g} m, below 0 m; change its range"
        )
    most = MOST_LEVELS if permittivity is None or rms_height is None else MOST_LEVELS_OF_TWO
    shape = next(values.shape for values in (permittivity, rms_height) if values is not None)
    levels_e, index_e = _levels(permittivity, shape, most, material.permittivity.real)
    levels_r, index_r = _levels(rms_height, shape, most, material.rms_height)
    pair = index_e * len(levels_r) + index_r
    used, number = np.unique(pair, return_inverse=True)
    parts = []
    for k in used.tolist():
        eps, height = float(levels_e[k // len(levels_r)]), float(levels_r[k % len(levels_r)])
        loss = material.permittivity.imag / max(material.permittivity.real, 1e-12)
        parts.append(
            replace(
                material,
                maps=None,
                permittivity=material.permittivity if permittivity is None else complex(eps, eps * loss),
                dispersion=material.dispersion if permittivity is None else None,
                rms_height=height,
            )
        )
    return number.reshape(shape).astype(np.int64), tuple(parts)


def _levels(values: F64 | None, shape: tuple[int, ...], most: int, own: float) -> tuple[F64, I64]:
    """Quantised values of a bitmap, and the index of each texel's value."""
    if values is None:
        return np.array([own]), np.zeros(shape, dtype=np.int64)
    found, index = np.unique(values, return_inverse=True)
    if len(found) > most:
        positive = found[found > 0.0]
        least = max(float(positive[0]), 1e-3 * float(positive[-1]))
        found = np.geomspace(least, float(positive[-1]), most)
        index = np.rint(np.log(np.maximum(values, least) / least) / np.log(found[1] / least))
    return np.asarray(found, dtype=np.float64), np.asarray(index, dtype=np.int64).reshape(shape)
