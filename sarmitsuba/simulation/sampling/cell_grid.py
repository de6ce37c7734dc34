"""Rays through the scatterer cells of bare level ground: one per cell, its tube the cell itself."""

import numpy as np
from numpy.typing import NDArray

from sarmitsuba.scene.scene import Scene
from sarmitsuba.simulation.sampling.launch_window import LaunchWindow
from sarmitsuba.trace.launch import LaunchFrame, LaunchGrid, morton

F64 = NDArray[np.float64]


def cell_grid(scene: Scene, window: LaunchWindow, cell: float) -> LaunchGrid:
    """One ray through the middle of every scatterer cell of level ground, its tube the cell itself.

    The launch plane is the surface: all visible geometry must lie in one level plane. The cells are those that
    :class:`sarmitsuba.trace.speckle.CellFrame` finds, aligned with the scene's axes. No pass or subset differs.

    Parameters
    ----------
    scene : visible geometry and the antenna's track
    window : lit part of the scene
    cell : m, edge of a scatterer cell
    """
    geometry, antenna = scene.geometry, scene.radar.track.center_position
    visible = ~np.array([m.invisible for m in scene.materials], dtype=bool)[geometry.face_material]
    ground = geometry.vertices[geometry.faces[visible].ravel()]
    level = 0.5 * float(ground[:, 2].min() + ground[:, 2].max())
    hx, hy = window.half_x + window.taper, window.half_y + window.taper
    frame = window.frame
    rim = [frame.center[0] + x * frame.axis_x[0] + y * frame.axis_y[0] for x in (-hx, hx) for y in (-hy, hy)]
    ray = np.array(rim) - antenna
    rim = antenna + ray * ((level - antenna[2]) / ray[:, 2])[:, None]
    low = np.maximum(rim.min(axis=0), ground.min(axis=0))[:2]
    high = np.minimum(rim.max(axis=0), ground.max(axis=0))[:2]
    first, last = np.floor(low / cell), np.floor(high / cell)
    middle = np.floor(0.5 * (first + last))  # the plane's centre: float32 coordinates start there
    rows, columns = (np.arange(a, b + 1.0) for a, b in zip(first, last, strict=True))
    parts = []
    step = max(1, 4_000_000 // columns.size)  # bounds the temporary arrays of one slab
    for start in range(0, rows.size, step):
        i, j = rows[start : start + step, None], columns[None, :]
        seen = _on_level(antenna, frame, (i + 0.5) * cell, (j + 0.5) * cell, level)
        beyond = [np.abs(v) - half for v, half in zip(seen, (window.half_x, window.half_y), strict=True)]
        keep = (beyond[0] <= window.taper) & (beyond[1] <= window.taper)
        fade = [
            0.5 + 0.5 * np.cos(np.pi * np.clip(b[keep] / max(window.taper, 1e-6), 0.0, 1.0)) for b in beyond
        ]
        a, b = np.nonzero(keep)
        xy = np.stack([i[a, 0] - middle[0] + 0.5, columns[b] - middle[1] + 0.5], axis=1) * cell
        parts.append((xy, fade[0] * fade[1]))
    xy, weight = (np.concatenate(a) for a in zip(*parts, strict=True))
    order = np.argsort(morton(xy[:, 0], xy[:, 1], float(np.abs(xy).max(initial=cell))), kind="stable")
    x, y = np.ascontiguousarray(xy[order].T, dtype=np.float32)
    plane = LaunchFrame(
        np.array([[middle[0] * cell, middle[1] * cell, level]]),
        np.array([[1.0, 0.0, 0.0]]),
        np.array([[0.0, 1.0, 0.0]]),
    )
    return LaunchGrid(
        x,
        y,
        cell,
        0.0,
        window.half_x,
        window.half_y,
        window.taper,
        "diffuse",
        plane,
        weight[order].astype(np.float32) if window.taper > 0 else None,
    )


def _on_level(antenna: F64, frame: LaunchFrame, x: F64, y: F64, z: float) -> tuple[F64, F64]:
    """What :func:`sarmitsuba.trace.launch.project` gives for a grid of points (x, y) of one level."""
    ux, uy = frame.axis_x[0], frame.axis_y[0]
    w = np.cross(ux, uy)

    def along(v: F64) -> F64:
        return np.asarray((x - antenna[0]) * v[0] + ((y - antenna[1]) * v[1] + (z - antenna[2]) * v[2]))

    offset = frame.center[0] - antenna
    t = (offset @ w) / along(w)
    return t * along(ux) - offset @ ux, t * along(uy) - offset @ uy


__all__ = ["cell_grid"]
