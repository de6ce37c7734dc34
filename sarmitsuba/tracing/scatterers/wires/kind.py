"""Wires of a scene: straight round cables, rails, posts and members of masts; their bsdf, reader and effect."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import ClassVar

import numpy as np

from sarmitsuba.core.arrays import F64, I32
from sarmitsuba.core.constants import SPEED_OF_LIGHT
from sarmitsuba.core.errors import SceneError
from sarmitsuba.core.parameters import Value, string_value
from sarmitsuba.core.units import db_from_power
from sarmitsuba.effects.context import SceneContext
from sarmitsuba.effects.effect import EFFECTS, Assessment, Decision, Effect
from sarmitsuba.effects.text import length
from sarmitsuba.loading.elements import Element
from sarmitsuba.loading.material_tables import PERMITTIVITY
from sarmitsuba.loading.notes import warn_once
from sarmitsuba.loading.scatterer_shapes import Reading, ShapeKind
from sarmitsuba.loading.shapes import Placed, cylinder_axis, mesh_path
from sarmitsuba.machine.regular_files import read_text
from sarmitsuba.scene.materials.bsdfs import given_permittivity, refuse_two_permittivities
from sarmitsuba.scene.materials.named_materials import MATERIALS
from sarmitsuba.scene.scatterers import SCATTERERS, Target
from sarmitsuba.scene.scene import Scene
from sarmitsuba.tracing.scatterers.wires.cylinder import largest_ka

# wires thicker than a third of their length are no wires: their caps return as much as their sides
LEAST_SLENDERNESS = 3.0
# largest ratio of the widths of a wire's cross-section that counts as round
ROUND = 1.01
# faces of a prism whose first three corners are those of one end
_PRISM_FACES = np.array(
    [f for i in range(3) for f in ([i, (i + 1) % 3, i + 3], [(i + 1) % 3, (i + 1) % 3 + 3, i + 3])]
)


@dataclass(frozen=True, eq=False)
class WireTarget:
    """Straight round wire that scatters by the series of the infinite cylinder; no ray hits it.

    Parameters
    ----------
    name : of the shape that it came from
    start, end : (3,) float64, m, scene frame
    radius : m
    permittivity : relative, eps' - j eps''; None is a perfect conductor

    Raises
    ------
    SceneError : it has no length, or no thickness
    """

    kind: ClassVar[str] = "radar_wire"

    name: str
    start: F64
    end: F64
    radius: float
    permittivity: complex | None = None

    def __post_init__(self) -> None:
        if not (np.isfinite(self.ends).all() and self.length > 0.0):
            raise SceneError(
                f'radar_wire "{self.name}": its ends are not two different finite points; give start and end'
            )
        if not 0.0 < self.radius < np.inf:
            raise SceneError(
                f'radar_wire "{self.name}": radius = {self.radius:g} m is not above 0 m; give a radius'
            )

    @property
    def ends(self) -> F64:
        """Start and end, (2, 3) float64, m, scene frame."""
        return np.stack([self.start, self.end])

    @property
    def places(self) -> F64:
        """See :class:`sarmitsuba.scene.scatterers.Target`: both ends."""
        return self.ends

    @property
    def segments(self) -> F64:
        """The wire, (1, 2, 3) float64, m, scene frame."""
        return self.ends[None]

    @property
    def length(self) -> float:
        """Length from end to end, m."""
        return float(np.linalg.norm(self.end - self.start))

    def moved(self, step: F64) -> "WireTarget":
        """The wire translated by (3,) m."""
        return WireTarget(self.name, self.start + step, self.end + step, self.radius, self.permittivity)


class WireKind(ShapeKind):
    """Wires as shapes with a ``radar_wire``."""

    name = WireTarget.kind
    title = (
        "On a `cylinder` or `linearcurve`: wires, which scatter by the series of the infinite cylinder; no ray hits "
        "them, and they cast no shadow. Perfect conductors by default."
    )
    parameters = PERMITTIVITY
    hints: ClassVar[Mapping[str, str]] = {"rms_height": "wires are smooth", "diffuse_law": "wires are smooth"}
    on = "a cylinder or a linearcurve"
    plural, mechanism, shown_as = "wires", "wire", "metal wires"
    rank = 10
    frequencies = 1

    def read(self, placed: Placed, bsdf: Element, reading: Reading) -> Sequence[WireTarget]:
        """See :class:`ShapeKind`."""
        values, given = reading.overrides.read(bsdf, self.table)
        permittivity, note = wire_permittivity(values, given, reading.frequency, bsdf.where)
        if note:
            warn_once(reading.notes, f"{bsdf.where.partition(':')[0]}: {note}")
        return read_wires(placed, permittivity, reading.frequency)

    def drawn(self, targets: Sequence[Target], thinnest: float) -> tuple[F64, I32]:
        """Three-sided prisms."""
        corners = [_prism(wire, thinnest) for wire in wires_of(targets)]
        faces = 6 * np.arange(len(corners))[:, None, None] + _PRISM_FACES
        return np.concatenate(corners), faces.reshape(-1, 3).astype(np.int32)


def wires_of(targets: Sequence[Target]) -> tuple[WireTarget, ...]:
    """The wires among the scatterers of a scene."""
    return tuple(target for target in targets if isinstance(target, WireTarget))


def _prism(wire: WireTarget, thinnest: float) -> F64:
    """Corners of the prism of a wire, (6, 3), with a radius of ``thinnest``, m, at least."""
    axis = (wire.end - wire.start) / wire.length
    x = np.cross(axis, np.eye(3)[int(np.argmin(np.abs(axis)))])
    x /= np.linalg.norm(x)
    angle = 2.0 * np.pi / 3.0 * np.arange(3)[:, None]
    rim = max(wire.radius, thinnest) * (np.cos(angle) * x + np.sin(angle) * np.cross(axis, x))
    return np.concatenate([wire.start + rim, wire.end + rim])


def wire_permittivity(
    values: Mapping[str, Value | None], given: frozenset[str], frequency: float, where: str
) -> tuple[complex | None, str]:
    """Relative permittivity of a validated ``radar_wire`` element, None for a conductor, and a note (may be empty)."""
    if not given & {"material", "permittivity_real", "permittivity_imag", "conductivity"}:
        return None, ""
    refuse_two_permittivities(given, where)
    name = string_value(values, "material")
    if not name:
        return given_permittivity(values, given, frequency), ""
    entry = MATERIALS[name]
    return (None, "") if entry.pec else (entry.permittivity(frequency), entry.note(frequency))


def read_wires(placed: Placed, permittivity: complex | None, frequency: float) -> list[WireTarget]:
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


class LineScatterers(Effect):
    """Wires; on where the scene has any, off leaves them out."""

    name = "line_scatterers"
    title = "wires, rails and posts"
    documentation = "returns of wires: cylinders and linearcurves with a `radar_wire`"
    off_when = "the scene has no `radar_wire`"
    off_means = "no echoes of wires"
    rank = 136

    def assess(self, context: SceneContext, decided: Mapping[str, Decision]) -> Assessment:
        """See the class."""
        wires = wires_of(context.scene.scatterers)
        if not wires:
            return Assessment(False, "no radar_wire", -np.inf)
        wavelength = context.scene.radar.waveform.wavelength
        # optics limit at normal incidence
        glint = max(2.0 * np.pi * wire.radius * wire.length**2 / wavelength for wire in wires)
        what = "1 wire" if len(wires) == 1 else f"{len(wires)} wires"
        total = sum(wire.length for wire in wires)
        why = f"{what}, {length(total)} in all, glints up to about {db_from_power(glint):.0f} dBsm"
        return Assessment(True, why, 0.0)

    def without(self, scene: Scene) -> Scene:
        """Scene without its wires."""
        return scene.without_kind(WireTarget.kind)


SCATTERERS.register(WireKind())
EFFECTS.register(LineScatterers())
