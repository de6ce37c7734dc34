"""Wires of a scene file: cylinders and polylines that scatter by a closed form."""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from sarmitsuba.core.arrays import F64
from sarmitsuba.core.constants import SPEED_OF_LIGHT
from sarmitsuba.core.errors import SceneError
from sarmitsuba.loading.elements import Element
from sarmitsuba.loading.shapes import Placed, cylinder_axis, mesh_path
from sarmitsuba.machine.regular_files import read_text
from sarmitsuba.scene.materials.cylinder import largest_ka
from sarmitsuba.scene.wires import WireTarget

# wires thicker than a third of their length are no wires: their caps return as much as their sides
LEAST_SLENDERNESS = 3.0
# largest ratio of the widths of a wire's cross-section that counts as round
ROUND = 1.01


def wires(placed: Placed, permittivity: complex | None, frequency: float) -> list[WireTarget]:
    """Wires of a ``cylinder``, or of a ``linearcurve``, one for each piece.

    Parameters
    ----------
    placed : shape with ``radar_wire``
    permittivity : relative; None is a perfect conductor
    frequency : Hz

    Raises
    ------
    SceneError : the shape is neither, moves, has a file that cannot be read, or is no thin round wire
    """
    element, where = placed.element, placed.element.where
    if not placed.motion.still:
        raise SceneError(
            f"{where}: radar_wire on a shape that moves; leave its velocity out, or make it a mesh"
        )
    if element.plugin == "cylinder":
        p0, p1, radius = cylinder_axis(element)
        curves = [np.array([[*p0, radius], [*p1, radius]])]
    elif element.plugin == "linearcurve":
        curves = _curves(element)
    else:
        raise SceneError(
            f"{where}: radar_wire is on a {element.plugin}; put it on a cylinder or a linearcurve"
        )
    out: list[WireTarget] = []
    for curve in curves:
        for (*p0, first), (*p1, second) in pairwise(curve):
            ends = placed.moved(np.array([p0, p1]))
            name = placed.name if not out else f"{placed.name}/{len(out) + 1}"
            radius = 0.5 * (first + second) * _widening(placed, ends, np.array(p1) - p0)
            _check(where, ends, radius, permittivity, frequency)
            out.append(WireTarget(name, ends[0], ends[1], radius, permittivity))
    return out


def _check(where: str, ends: F64, radius: float, permittivity: complex | None, frequency: float) -> None:
    length, wavelength = float(np.linalg.norm(ends[1] - ends[0])), SPEED_OF_LIGHT / frequency
    ka, bound = 2.0 * np.pi * radius / wavelength, largest_ka(permittivity)
    if not np.isfinite(length) or length < LEAST_SLENDERNESS * 2.0 * radius:
        raise SceneError(
            f"{where}: radar_wire of {length:g} m and {2.0 * radius:g} m across is too thick: it must be at least "
            f"{LEAST_SLENDERNESS:g} times as long as wide; make it a mesh (radar_material)"
        )
    if ka > bound:
        raise SceneError(
            f"{where}: radar_wire of radius {radius:g} m is {ka:.0f} wavelengths around, above the bound {bound:g}; "
            "make it a mesh (radar_material)"
        )


def _widening(placed: Placed, ends: F64, local: F64) -> float:
    """Factor of ``to_world`` on a wire's radius.

    Raises
    ------
    SceneError : it makes the cross-section oval
    """
    linear = placed.to_world[:3, :3]
    axis = (ends[1] - ends[0]) / max(float(np.linalg.norm(ends[1] - ends[0])), 1e-300)
    z = local / max(float(np.linalg.norm(local)), 1e-300)
    x = np.cross(z, np.eye(3)[int(np.argmin(np.abs(z)))])
    x /= max(float(np.linalg.norm(x)), 1e-300)
    across = linear @ np.stack([x, np.cross(z, x)], axis=1)
    widths = np.linalg.svd(across - np.outer(axis, axis @ across), compute_uv=False)
    if not widths[1] > 0.0 or widths[0] > ROUND * widths[1]:
        raise SceneError(
            f"{placed.element.where}: to_world makes a radar_wire oval ({widths[0]:g} by {widths[1]:g} of its width); "
            "scale it equally in all directions"
        )
    return float(np.sqrt(widths[0] * widths[1]))


def _curves(element: Element) -> list[F64]:
    """Polylines of a file of Mitsuba's ``linearcurve``: rows x y z radius, a blank row between curves."""
    path, where = mesh_path(element), element.where
    curves: list[list[Sequence[float]]] = [[]]
    try:
        text = read_text(path)
    except OSError as error:
        raise SceneError(f"{where}: cannot read {path.name}: {error.strerror}") from error
    for number, row in enumerate(text.splitlines(), 1):
        if not row.split():
            curves.append([])
            continue
        try:
            values = [float(word) for word in row.split()]
        except ValueError:
            values = []
        if len(values) != 4 or not np.isfinite(values).all() or values[3] <= 0.0:
            raise SceneError(
                f'{where}: row {number} of {path.name} is not "x y z radius" with a radius above 0 m; correct it'
            )
        curves[-1].append(values)
    out = [np.array(curve) for curve in curves if curve]
    if not out or min(map(len, out)) < 2:
        raise SceneError(
            f"{where}: {path.name} holds a curve of fewer than two points; give at least two rows each"
        )
    return out
