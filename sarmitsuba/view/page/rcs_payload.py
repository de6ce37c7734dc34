"""Content of the page of an RCS sweep: target, RCS over aspect, and image."""

import numpy as np

from sarmitsuba.core.arrays import F64
from sarmitsuba.scene.scene import Scene
from sarmitsuba.signal.image.sar_image import SarImage
from sarmitsuba.simulation.execution.far_field import target_middle
from sarmitsuba.simulation.execution.turntable import RcsSweep
from sarmitsuba.version import __version__
from sarmitsuba.view.page.gltf import drawn, page_mesh
from sarmitsuba.view.page.payload import Value, grid_payload, image_payload, nested, scene_payload
from sarmitsuba.view.page.quantised_profiles import page_grid
from sarmitsuba.view.polar import POLAR_FROM

PAGE = "rcs.html"


def rcs_payload(scene: Scene, sweep: RcsSweep, image: SarImage | None) -> dict[str, Value]:
    """Content of the page of an RCS sweep.

    Parameters
    ----------
    scene : the target
    sweep : its RCS, shown unrounded
    image : made from the sweep's arc, with the same channels; None: no image
    """
    middle, radius = target_middle(scene)
    center = middle + scene.offset
    geometry, _ = drawn(scene)
    lowest = scene.geometry.bounds[0, 2] if scene.geometry.n_faces else middle[2] - radius
    angles = [np.degrees(sweep.aspects.azimuth), np.degrees(sweep.aspects.elevation)]
    by_elevation = not sweep.aspects.by_azimuth and angles[0].size > 1
    return {
        "title": scene.name,
        "version": __version__,
        "center": center,
        "radius": max(radius, 1e-3),
        "below": float(middle[2] - lowest),
        "scenes": [scene_payload(scene, page_mesh(geometry, center), center)],
        "frequency": sweep.frequency,
        "swept": "elevation" if by_elevation else "azimuth",
        "polar": bool(np.ptp(angles[by_elevation]) >= POLAR_FROM),
        "whole": sweep.aspects.whole_circle,
        "azimuth": angles[0],
        "elevation": angles[1],
        "channels": [_channel(sweep, name) for name in sweep.result.channels],
        "statement": {"text": sweep.statement.text, "warning": sweep.statement.warning},
        "image": None if image is None else _image(image, sweep, center),
    }


def _channel(sweep: RcsSweep, name: str) -> dict[str, Value]:
    """Curves of one polarisation, dB above 1 m^2, and the phase of their sum, deg."""
    i = sweep.result.channels.index(name)
    error = sweep.error_db[i]
    return {
        "name": name,
        "error": error if np.isfinite(error) else None,
        "total": sweep.dbsm(name),
        "phase": np.degrees(np.angle(sweep.total[:, i])),
        "orders": [{"order": order, "dbsm": sweep.dbsm(name, order)} for order in sweep.orders],
    }


def _image(image: SarImage, sweep: RcsSweep, center: F64) -> dict[str, Value]:
    """Image of every channel; axes from the target's centre, or x and y of the file for a full circle."""
    grid = image.grid.in_frame(np.zeros(3))
    pixels = nested(*page_grid(image.grid))
    origin = grid.origin * [1.0, 1.0, 0.0] - (0.0 if sweep.aspects.whole_circle else center)
    pixels["azimuth"] = grid.azimuth + float(origin @ grid.along)
    pixels["range"] = grid.across_distance() + float(origin @ grid.across)
    return {
        "grid": grid_payload(grid, center),
        "pixels": pixels,
        # radar cross section of points, not sigma0 of areas
        "channels": [image_payload(image, name) | {"cell_area": None} for name in sweep.result.channels],
    }
