"""Warnings about rays that were asked for too far apart."""

import warnings
from collections.abc import Iterator

import numpy as np

from sarmitsuba.errors import SarmitsubaWarning
from sarmitsuba.scene.geometry import Geometry
from sarmitsuba.simulation.sampling.plan import RAYS_PER_WAVELENGTH, SamplingPlan
from sarmitsuba.simulation.statistics import LatticeSpacings

# share of the surface in facets smaller than the rays' spacing that is worth a warning
SMALL_FACETS = 0.01


def check_sampling(sampling: SamplingPlan, spacings: LatticeSpacings) -> list[str]:
    """Warn of rays that are too far apart for the resolution or for the diffuse scatterers; the warnings' texts."""
    notes = [f"{sampling.scene.name}: {text}" for text in _too_wide(sampling, spacings)]
    for note in notes:
        warnings.warn(note, SarmitsubaWarning, stacklevel=4)
    return notes


def _too_wide(sampling: SamplingPlan, spacings: LatticeSpacings) -> Iterator[str]:
    coherent, half_cell, fine = spacings.of_coherent, sampling.half_cell, sampling.fine_spacing
    if coherent > 1.01 * half_cell:
        yield (
            f"ray_spacing = {coherent:g} m is coarser than half a resolution cell; "
            f"set it to {half_cell:.3g} m or less"
        )
    if sampling.scene.settings.ray_spacing > 0 and coherent > 1.01 * fine:
        share = share_of_small_facets(sampling.scene.geometry, coherent)
        if share > SMALL_FACETS:
            yield (
                f"ray_spacing = {coherent:g} m is coarser than the facets of curved surfaces, {100 * share:.0f} % of "
                f"the area; their coherent return needs {RAYS_PER_WAVELENGTH:g} rays per wavelength: {fine:.3g} m"
            )
    wanted = sampling.footprint_spacing
    if spacings.diffuse > 1.5 * wanted:
        yield (
            f"diffuse_ray_spacing = {spacings.diffuse:g} m is too coarse: some scatterer cells get no ray; cells are "
            f"{sampling.scatterer_cell:.3g} m wide; set it to {wanted:.3g} m or less"
        )


def share_of_small_facets(geometry: Geometry, spacing: float) -> float:
    """Share of the surface in smooth pieces' facets narrower than the rays' spacing: what tubes cannot resolve.

    Single flat facets of any size telescope to their rims; it is the small facets of curved surfaces that need
    several rays each. Flat pieces cut into small triangles count as one facet.
    """
    v, f = geometry.vertices, geometry.faces
    a, b = v[f[:, 1]] - v[f[:, 0]], v[f[:, 2]] - v[f[:, 0]]
    normal = np.cross(a, b)
    area = 0.5 * np.linalg.norm(normal, axis=1)
    normal /= np.maximum(2.0 * area, 1e-300)[:, None]
    group = geometry.face_group
    n = int(group.max()) + 1
    total = np.bincount(group, area, n)
    mean = np.stack([np.bincount(group, area * normal[:, i], n) for i in range(3)], axis=1)
    # a flat group's mean normal has length one
    curved = np.linalg.norm(mean, axis=1) < (1.0 - 1e-6) * total
    longest = np.sqrt(np.maximum.reduce([(e * e).sum(axis=1) for e in (a, b, a - b)]))
    narrow = 2.0 * area < spacing * np.maximum(longest, 1e-300)
    small = narrow & curved[group]
    return float(area[small].sum() / max(area.sum(), 1e-300))


__all__ = ["check_sampling", "share_of_small_facets"]
