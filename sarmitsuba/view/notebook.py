"""Pictures for notebooks: images and plan views of scenes as PNG."""

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection

from sarmitsuba.radar.radar import Radar
from sarmitsuba.radar.swath import illuminate_points, outline
from sarmitsuba.scene.scene import Scene
from sarmitsuba.signal.image import Multilook, SarImage, ShownAxes
from sarmitsuba.view.figure import Figure
from sarmitsuba.view.quicklook import quicklook, save

# most triangles drawn in a plan; the largest ones are kept
_MOST_FACES = 20_000
# points across a plan at which the coverage by a complete aperture is evaluated
_SHADED = 61
_BEAM = "tab:blue"
# margin around a complete beam, relative to its extent
_RIM = 0.03


def image_figure(image: SarImage, path: Path | str | None = None, channel: str | None = None) -> Figure:
    """Quick-look of a channel, written if a path is given, in the format of its suffix (PNG, JPEG, PDF, SVG)."""
    figure = quicklook(image, channel=channel)
    if path is not None:
        save(figure, path)
    return figure


def multilook_figure(looks: Multilook) -> Figure:
    """Draw multi-looked power, dB, between its 1st and 99.5th percentile."""
    level = looks.to_db()
    finite = level[np.isfinite(level)]
    low, high = np.percentile(finite, (1.0, 99.5)) if finite.size else (0.0, 1.0)
    figure = Figure(figsize=(5.6, 4.6), dpi=100.0, layout="constrained")
    axes = figure.add_subplot()
    # as in the picture of the image itself: near range on the left, azimuth upwards, whichever way numbers run
    frame = None if looks.grid is None else ShownAxes.of(looks.grid)
    across, up = (looks.range, looks.azimuth) if frame is None else frame.shown(looks.azimuth, looks.range)
    shown = axes.pcolormesh(
        across,
        up,
        np.maximum(level, low),
        cmap="gray",
        vmin=low,
        vmax=high,
        shading="nearest",
    )
    if frame is None:
        axes.set(xlabel="range (m)", ylabel="azimuth (m)")
    else:
        axes.set(xlabel=frame.range_label, ylabel=frame.azimuth_label)
    if across[-1] < across[0]:
        axes.invert_xaxis()
    if up[-1] < up[0]:
        axes.invert_yaxis()
    axes.set_aspect("equal")
    axes.ticklabel_format(useOffset=False, style="plain")
    axes.locator_params(axis="x", nbins=4)
    unit = "dBsm" if looks.quantity == "rcs" else "dB"
    what = f"{looks.quantity} ({unit})" if looks.calibrated else f"{looks.quantity}, uncalibrated (dB)"
    figure.colorbar(shown, ax=axes, label=f"{looks.channel} {what}")
    return figure


def scene_plan(scene: Scene, *, whole_beam: bool = False) -> Figure:
    """Plan view of a scene: faces by height, ideal points, image outline, directions of flight and look, beam.

    The beam is drawn as its half-power outline on the image plane at the track's first, middle and last pulse; the area
    with a complete aperture is shaded. Axes are metres of the scene frame, east to the right and north up.

    Parameters
    ----------
    scene : to draw
    whole_beam : True widens the view until it holds the beam
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
        order = np.argsort(height, kind="stable")  # higher faces cover lower ones
        outlines = list(corners[order][:, :, :2])
        faces = PolyCollection(
            outlines, array=height[order], cmap="cividis", edgecolors="face", linewidths=0.3
        )
        axes.add_collection(faces)
        figure.colorbar(faces, ax=axes, label="height (m)")
    lines = [ends for ends in scene.segments if (ends[0] != ends[1]).any()]
    for number, ends in enumerate(lines):
        axes.plot(*ends[:, :2].T, "b-", linewidth=0.8, label="" if number else "lines")
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
            parse_math=False,
        )
    axes.set_aspect("equal")
    axes.autoscale_view()
    draw_beam(axes, radar, image.height, whole=whole_beam)
    axes.set_xlabel("east (m)")
    axes.set_ylabel("north (m)")
    axes.set_title(scene.name, fontsize=9, parse_math=False)
    return figure


def draw_beam(axes: Axes, radar: Radar, height: float, *, whole: bool = False) -> None:
    """Draw half-power outlines of the beam at the first, middle and last pulse, and the area with a complete aperture.

    For a track around the scene, the outlines are those of its quarters.

    Parameters
    ----------
    axes : of a plan, east to the right and north up, m of the scene frame
    radar : of the beam; an isotropic antenna has no outline
    height : of the plane, m, scene frame
    whole : True widens the axes to include the beam; otherwise their limits are kept
    """
    if not radar.antenna.directive:
        return
    x, y = axes.get_xlim(), axes.get_ylim()
    last = radar.track.n_pulses - 1
    shown = (0.0, 0.25, 0.5, 0.75) if radar.all_round else (0.0, 0.5, 1.0)
    pulses = sorted({round(share * last) for share in shown})
    ends = [outline(radar, pulse, height)[:, :2] for pulse in pulses]
    if whole:
        around = np.concatenate([*ends, np.transpose([x, y])])
        low, high = np.nanmin(around, axis=0), np.nanmax(around, axis=0)
        low, high = low - _RIM * (high - low), high + _RIM * (high - low)
        x, y = (low[0], high[0]), (low[1], high[1])
    for line, style in zip(ends, ("--", "-", ":", "-.")[: len(ends)], strict=True):
        axes.plot(*line.T, style, color=_BEAM, linewidth=1.0)
    east, north = np.meshgrid(np.linspace(*x, _SHADED), np.linspace(*y, _SHADED))
    share = illuminate_points(radar, np.stack([east, north, np.full_like(east, height)], axis=-1)).whole
    axes.contourf(east, north, share, levels=[0.5, 1.5], colors=[_BEAM], alpha=0.15)
    axes.set_xlim(x)
    axes.set_ylim(y)


_AROUND = ((-1, -1), (1, -1), (1, 1), (-1, 1), (-1, -1))
