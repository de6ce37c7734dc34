"""Optical plan of a scene beside its image: faces seen from above, shaded, on axes of the ground."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection

from sarmitsuba.scene.scene import Scene
from sarmitsuba.signal.image.sar_image import ImageGrid
from sarmitsuba.signal.image.shown_axes import ShownAxes

# colours of materials in turn, and light from near range and late azimuth (the upper left), above
_COLOURS = np.array(
    [(0.80, 0.78, 0.70), (0.86, 0.66, 0.56), (0.62, 0.72, 0.84), (0.66, 0.80, 0.64), (0.82, 0.74, 0.86)]
)
_LIGHT = np.array([-0.5, 0.5, 1.0]) / np.sqrt(1.5)
_DARKEST = 0.35  # of faces turned away
# most faces drawn; the largest ones are kept
_MOST = 200_000


def ground_grid(grid: ImageGrid) -> ImageGrid:
    """Grid on the ground of the extent of an image; that of a slant-range image, has even steps."""
    if grid.kind == "ground":
        return grid
    across = grid.across_distance()
    near, far = float(across[0]), float(across[-1])
    middle = 0.5 * (near + far)
    flat = np.array([grid.origin[0], grid.origin[1], grid.height])
    return ImageGrid(
        "ground",
        grid.azimuth,
        np.linspace(near - middle, far - middle, grid.range.size),
        flat + middle * grid.across,
        grid.along,
        grid.across,
        grid.height,
        grid.offset,
        grid.anchor,
    )


def draw_plan(axes: Axes, scene: Scene, grid: ImageGrid, frame: str | None = None) -> None:
    """Draw the scene from above at time zero, range to the right and azimuth upwards.

    Parameters
    ----------
    axes : get the limits of the grid's picture
    scene : to draw
    grid : the image's; slant-range images are shown over ground range
    frame : of the axes' numbers, see :class:`sarmitsuba.signal.image.shown_axes.ShownAxes`
    """
    ground = ground_grid(grid)
    shown = ShownAxes.of(ground, frame)
    left, right, below, above = shown.extent(ground)
    own = ground.in_frame(scene.radar.offset)
    offset = scene.geometry.vertices - own.origin
    across, up = shown.shown(offset @ own.along, offset @ own.across)
    corner = np.stack([across, up], axis=-1)[scene.geometry.faces]
    turned = np.stack([offset @ own.across, offset @ own.along, offset[:, 2]], axis=-1)[scene.geometry.faces]
    inside = np.ones(len(corner), dtype=bool)
    for i, ends in enumerate(((left, right), (below, above))):
        inside &= (corner[:, :, i].max(axis=1) > min(ends)) & (corner[:, :, i].min(axis=1) < max(ends))
    normal = np.cross(turned[:, 1] - turned[:, 0], turned[:, 2] - turned[:, 0])
    area = np.linalg.norm(normal, axis=1)
    pick = np.flatnonzero(inside & (np.abs(normal[:, 2]) > 1e-9 * area))
    pick = pick[np.argsort(-area[pick], kind="stable")[:_MOST]]
    pick = pick[np.argsort(turned[pick, :, 2].mean(axis=1), kind="stable")]  # higher faces cover lower ones
    unit = normal[pick] / area[pick, None] * np.sign(normal[pick, 2:])
    light = _DARKEST + (1.0 - _DARKEST) * np.maximum(unit @ _LIGHT, 0.0) / _LIGHT[2]
    colour = _COLOURS[scene.geometry.face_material[pick] % len(_COLOURS)]
    axes.set_facecolor("0.9")
    axes.add_collection(
        PolyCollection(
            list(corner[pick]),
            facecolors=np.clip(colour * light[:, None], 0.0, 1.0),
            edgecolors="face",
            linewidths=0.2,
        ),
        autolim=False,
    )
    if scene.points:
        place = np.array([point.position for point in scene.points]) - own.origin
        axes.plot(*shown.shown(place @ own.along, place @ own.across), "r+", label="points")
    axes.set_xlim(left, right)
    axes.set_ylim(below, above)
    axes.set_xlabel(shown.range_label, fontsize=9)
    axes.set_ylabel(shown.azimuth_label, fontsize=9)
    axes.tick_params(labelsize=8)
    axes.set_title("seen from above", fontsize=9)


def plan_width(grid: ImageGrid) -> float:
    """Width of the plan, m."""
    ground = ground_grid(grid)
    return ground.range_spacing * ground.range.size
