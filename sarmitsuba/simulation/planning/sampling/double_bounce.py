"""Ground beside a cropped image, towards the radar, that mirrors rays onto tall objects in the image."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import fresnel

from sarmitsuba.core.arrays import F64, box_of_each
from sarmitsuba.scene.scene import Scene

# largest share of rays that ground in front of the image may add to a launch window
MOST_RAYS = 0.25
# steepest angle of incidence, rad, of mirrored heights
GRAZING = 1.5
# dB, loss of a double bounce below which nothing is said
LEAST_LOSS = 0.5


@dataclass(frozen=True, eq=False)
class BounceGround:
    """Ground in front of walls in the image that lies outside the image's footprint, in axes (along, across).

    Parameters
    ----------
    low, high : (n, 2) m, box of the ground in front of each wall, as far as it mirrors onto its top and is there
    """

    low: F64
    high: F64

    @property
    def box(self) -> F64:
        """Bounds of all, (2, 2) m."""
        return np.stack([self.low.min(axis=0), self.high.max(axis=0)])

    def unlit(self, lit: F64, slope: float, fresnel_zone: float, spare: float) -> tuple[float, float]:
        r"""Largest width of the ground outside a lit box, m, and the largest loss of a double bounce by it, dB.

        A double bounce closes at the wall for both directions
        (:mod:`sarmitsuba.tracing.scatterers.corners.metal_corners`), with the amplitude
        :math:`S(H) = \int_0^H \exp(j \pi z^2 / 2 F^2) dz` of a wall of the height H; S(h) remains where ground is lit
        for the height h. The window's taper counts as light on half of its width.

        Parameters
        ----------
        lit : (2, 2) m, box along and across
        slope : tangent of the incidence angle
        fresnel_zone : F, m, for heights
        spare : m, half the width of the taper on the ground
        """
        outside = np.maximum(np.maximum(lit[0] - self.low, self.high - lit[1]), 0.0)
        width = np.linalg.norm(outside, axis=1)
        top = np.linalg.norm(self.high - self.low, axis=1) / slope
        imaginary, real = fresnel(
            np.stack([top, np.maximum(top - np.maximum(width - spare, 0.0) / slope, 0.0)]) / fresnel_zone
        )
        whole, part = real + 1j * imaginary
        loss = -20.0 * np.log10(np.maximum(np.abs(part) / np.abs(whole), 1e-2))
        return float(width.max()), float(loss.max())


def visible_faces(scene: Scene) -> NDArray[np.bool_]:
    """Which faces (n,) are visible."""
    return np.asarray(
        ~np.array([m.invisible for m in scene.materials], dtype=bool)[scene.geometry.face_material]
    )


def steep_faces(scene: Scene) -> tuple[NDArray[np.bool_], F64]:
    """Which faces (n,) are steeper than 60 degrees, and the areas of all, m^2."""
    corner = scene.geometry.vertices[scene.geometry.faces]
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    size = np.linalg.norm(normal, axis=1)
    return np.asarray(np.abs(normal[:, 2]) < 0.5 * size), np.asarray(0.5 * size)


def bounce_ground(scene: Scene, axes: F64, middle: F64, away: F64, incidence: float) -> BounceGround | None:
    """Ground beside the image's footprint that mirrors rays onto walls within it; None where there is none.

    A ray reflected by level ground at the distance z tan(incidence) in front of a wall meets it at the height z, and
    returns at the range of the wall's foot.

    Parameters
    ----------
    axes, middle : the image's middle, and axes along, across and up
    away : (3,) horizontal unit vector across the sector, away from the radar, in these axes
    incidence : rad, at the middle

    Notes
    -----
    Heights are above the image's plane. Ignored: motion of meshes; squint, which displaces that ground along the track;
    wires, volumes and ideal points as tall objects.
    """
    image, geometry = scene.image, scene.geometry
    if scene.settings.max_depth == 1 or not geometry.n_faces:
        return None
    half = 0.5 * np.array([image.extent_azimuth, image.extent_range])
    vertices = (geometry.vertices - middle) @ axes.T
    toward = -np.tan(min(incidence, GRAZING)) * away[:2]
    # most scenes end here: nothing beside the image in that direction, or nothing tall enough
    reach = max(0.0, float(vertices[:, 2].max())) * np.abs(toward)
    if not _overlap(vertices[:, :2].min(axis=0), vertices[:, :2].max(axis=0), half, reach, toward):
        return None
    corner = vertices[geometry.faces]
    low, high = box_of_each(corner)
    (steep, _), visible = steep_faces(scene), visible_faces(scene)
    tall = visible & steep & (high[:, 2] > 1e-6)
    tall &= (low[:, :2] < half).all(axis=1) & (high[:, :2] > -half).all(axis=1)
    level = visible & ~steep
    foot_low, foot_high = np.maximum(low[tall, :2], -half), np.minimum(high[tall, :2], half)
    shift = high[tall, 2, None] * toward
    # of a wall's footprint, the side towards the radar
    near = np.where(toward < 0.0, foot_low, foot_high)
    near = np.where(toward == 0.0, 0.5 * (foot_low + foot_high), near)
    first, last = np.minimum(near, near + shift), np.maximum(near, near + shift)
    out = ((first < -half - 1e-6) | (last > half + 1e-6)).any(axis=1)
    if not out.any():
        return None
    first, last = first[out], last[out]
    # the ground that is there, beside the image
    union = np.stack([first.min(axis=0), last.max(axis=0)])
    ground = level & (high[:, :2] > union[0]).all(axis=1) & (low[:, :2] < union[1]).all(axis=1)
    ground &= ((low[:, :2] < -half - 1e-6) | (high[:, :2] > half + 1e-6)).any(axis=1)
    if not ground.any():
        return None
    there = np.stack([low[ground, :2].min(axis=0), high[ground, :2].max(axis=0)])
    first, last = np.maximum(first, there[0]), np.minimum(last, there[1])
    kept = (first <= last).all(axis=1) & ((first < -half - 1e-6) | (last > half + 1e-6)).any(axis=1)
    return BounceGround(first[kept], last[kept]) if kept.any() else None


def unlit_ground(scene: Scene, width: float, loss: float) -> str:
    """Note on double bounces of tall objects at the image's edge whose ground is not lit; empty below ``LEAST_LOSS``.

    Parameters
    ----------
    width, loss : m and dB, see :meth:`BounceGround.unlit`
    """
    if loss < LEAST_LOSS:
        return ""
    return (
        f"{scene.name}: ground in front of tall objects at the image's edge towards the radar is lit in part only; "
        f"their double bounce is too weak, by up to {loss:.1f} dB: enlarge the image towards the radar by {width:.3g} m"
    )


def _overlap(low: F64, high: F64, half: F64, reach: F64, toward: F64) -> bool:
    """Whether a box of geometry extends beyond the image on a side towards the radar, where heights reach there."""
    below = (toward < -1e-9) & (reach > 1e-6) & (low < -half - 1e-6)
    above = (toward > 1e-9) & (reach > 1e-6) & (high > half + 1e-6)
    return bool((below | above).any())
