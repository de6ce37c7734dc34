"""What notebooks show: pictures of images and plans of scenes as PNG, no file and no window needed."""

import io
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure

from sarmitsuba.image.sar_image import SarImage
from sarmitsuba.scene.scene import Scene
from sarmitsuba.view.quicklook import quicklook, save

# triangles drawn in a plan; of more, the largest
_MOST_FACES = 20_000


def image_figure(image: SarImage, path: Path | str | None = None, channel: str | None = None) -> Figure:
    """Quick-look of a channel, written as PNG where there is a path."""
    figure = quicklook(image, channel=channel)
    if path is not None:
        save(figure, path)
    return figure


def image_png(image: SarImage) -> bytes:
    """Quick-look of the first channel as PNG."""
    return _png(quicklook(image))


def scene_png(scene: Scene) -> bytes:
    """Plan of a scene as PNG, see :func:`scene_plan`."""
    return _png(scene_plan(scene))


def scene_plan(scene: Scene) -> Figure:
    """A scene from above: faces by height, ideal points, the image's outline, directions of flight and look.

    Axes are metres of the scene frame, east to the right and north up.
    """
    figure = Figure(figsize=(5.2, 4.6), dpi=100.0, layout="constrained")
    axes = figure.add_subplot()
    geometry, image, radar = scene.geometry, scene.image, scene.radar
    corners = geometry.vertices[geometry.faces]
    if len(corners):
        normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        largest = np.argsort(-np.abs(normal[:, 2]), kind="stable")[:_MOST_FACES]
        corners = corners[largest]
        height = corners[:, :, 2].mean(axis=1)
        order = np.argsort(height, kind="stable")  # what is higher covers what is below
        outlines = list(corners[order][:, :, :2])
        faces = PolyCollection(
            outlines, array=height[order], cmap="cividis", edgecolors="face", linewidths=0.3
        )
        axes.add_collection(faces)
        figure.colorbar(faces, ax=axes, label="height (m)")
    if scene.points:
        place = np.array([point.position for point in scene.points])
        axes.plot(place[:, 0], place[:, 1], "r+", label="points")
    middle = np.array([image.center_x, image.center_y])
    along, across = radar.track.along[:2], radar.across[:2]
    half = 0.5 * np.array([image.extent_azimuth, image.extent_range])
    outline = [middle + a * half[0] * along + b * half[1] * across for a, b in _AROUND]
    axes.plot(*np.array(outline).T, "r-", linewidth=1.0, label="image")
    reach = 0.8 * half.min()
    for direction, name in ((along, "flight"), (across, "look")):
        start = middle - half[0] * along - half[1] * across
        axes.annotate(
            name,
            xy=tuple(start),
            xytext=tuple(start + reach * direction),  # the head is at the text
            arrowprops={"arrowstyle": "<|-", "color": "red"},
            color="red",
            fontsize=8,
        )
    axes.set_aspect("equal")
    axes.autoscale_view()
    axes.set_xlabel("east (m)")
    axes.set_ylabel("north (m)")
    axes.set_title(scene.name, fontsize=9)
    return figure


_AROUND = ((-1, -1), (1, -1), (1, 1), (-1, 1), (-1, -1))


def _png(figure: Figure) -> bytes:
    buffer = io.BytesIO()
    FigureCanvasAgg(figure).print_figure(buffer, format="png", dpi=100.0)
    return buffer.getvalue()


__all__ = ["image_figure", "image_png", "scene_plan", "scene_png"]
