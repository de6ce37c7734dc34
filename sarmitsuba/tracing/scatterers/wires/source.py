"""Echoes of wires: the current of the infinite cylinder, integrated over rows of nodes by linear (hat) functions."""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from sarmitsuba.core.arrays import F64
from sarmitsuba.machine.backend import dr, mi
from sarmitsuba.tracing.kernel import field
from sarmitsuba.tracing.kernel.device_arrays import device_array, vector_rows
from sarmitsuba.tracing.kernel.leg import Leg
from sarmitsuba.tracing.kernel.source import PointSource, Scatterers, Source
from sarmitsuba.tracing.scatterers.sources import SOURCES, Expected, Site, SourceKind, most_bounces
from sarmitsuba.tracing.scatterers.wires.cylinder import NUMBERS, cylinder_table, table_size
from sarmitsuba.tracing.scatterers.wires.kind import WireTarget, wires_of

if TYPE_CHECKING:
    from sarmitsuba.tracing.kernel.state import Kernel


# rad; largest difference between the two-way spherical and plane-wave phase at the end of a node's hat function.
# Its mean over the hat is a sixth of that: -50 dB
NEAR_PHASE = 0.02
# nodes in a resolution cell
PER_RANGE_CELL, PER_AZIMUTH_CELL = 4.0, 8.0
# seconds of a reference core: for laying out a node, for a table entry per order, and for tracing a node
NODE_LAID, NUMBER_LAID, NODE_TRACED = 1e-6, 1.1e-7, 1e-6
# bytes of a node and of a table entry while they are laid out
NODE_BYTES, NUMBER_BYTES = 300, 150
# point from which the visibility of an end is decided: the middle of its part of the wire, in lengths of that part
PROBE = 1.0 / 3.0


@dataclass(frozen=True, eq=False)
class WireNodes:
    """Integration nodes along wires.

    Parameters
    ----------
    point : (n, 3) float64, m
    inward : (n, 3) float64, m, from an end to the point within the wire at which its visibility is decided; else zero
    axis : (n, 3) unit vectors along the wire
    step : (n,) m between neighbours on the wire
    sides : (n, 2) 1 where the wire continues along the axis and against it, 0 beyond an end
    wire : (n,) number of the wire
    """

    point: F64
    inward: F64
    axis: F64
    step: F64
    sides: F64
    wire: NDArray[np.intp]

    def weigh(self, weight: F64) -> WireNodes:
        """The nodes of weight (n,) above 0, with amplitudes times the weight."""
        kept = weight > 1e-6
        return WireNodes(
            self.point[kept],
            self.inward[kept],
            self.axis[kept],
            self.step[kept],
            (self.sides * weight[:, None])[kept],
            self.wire[kept],
        )


def longest_step(range_cell: float, azimuth_cell: float, distance: float, wavelength: float) -> float:
    r"""Largest spacing of the nodes along a wire, m.

    A quarter of the range cell, for the ends of a slanting wire; an eighth of the azimuth cell, so that a node's
    pattern changes by 1.3 % over the whole aperture and by less over the pulses of one block; and short against the
    Fresnel zone,

    .. math:: k h^2 / R \le 0.02

    Parameters
    ----------
    range_cell, azimuth_cell : resolutions, m
    distance : R, smallest distance to an antenna, m
    wavelength : m
    """
    fresnel = np.sqrt(NEAR_PHASE * distance * wavelength / (2.0 * np.pi))
    return float(min(range_cell / PER_RANGE_CELL, azimuth_cell / PER_AZIMUTH_CELL, fresnel))


def cut_wires(wires: Sequence[WireTarget], longest: float) -> WireNodes:
    """Nodes along wires, spaced by at most ``longest``, m, with one at each end of a wire."""
    points, inward, axes, steps, sides, numbers = [], [], [], [], [], []
    for number, wire in enumerate(wires):
        n = max(1, int(np.ceil(wire.length / longest - 1e-9)))
        t = np.linspace(0.0, 1.0, n + 1)[:, None]
        axis, step = (wire.end - wire.start) / wire.length, wire.length / n
        points.append(wire.start * (1.0 - t) + wire.end * t)
        probe = np.zeros((n + 1, 3))
        probe[0], probe[-1] = PROBE * step * axis, -PROBE * step * axis
        inward.append(probe)
        axes.append(np.tile(axis, (n + 1, 1)))
        steps.append(np.full(n + 1, step))
        side = np.ones((n + 1, 2))
        side[-1, 0] = side[0, 1] = 0.0
        sides.append(side)
        numbers.append(np.full(n + 1, number))
    return WireNodes(*(np.concatenate(rows) for rows in (points, inward, axes, steps, sides, numbers)))


class WireScatterers(Scatterers):
    r"""Wires as scatterers, by the closed-form current of the infinite cylinder.

    .. math:: q \cdot S e = \frac{2}{\sqrt\pi} h F \left[T_{mm} (q \cdot \hat t_s)(\hat t_i \cdot e)
        + T_{ee} (q \cdot \hat p_s)(\hat p_i \cdot e)
        + T_{me} ((q \cdot \hat t_s)(\hat p_i \cdot e) - (q \cdot \hat p_s)(\hat t_i \cdot e))\right]

    with p along axis x ray, t across p and the ray, and F the integral over the node's hat, of half width h,

    .. math:: F = \int_{-1}^{1} w(t) (1 - |t|) e^{-j k h (\hat d - \hat s) \cdot \hat a\, t} dt

    whose w is 0 beyond an end of the wire, else 1. Hats of neighbours sum to one: at the carrier the sum over the nodes
    is the integral over the wire, however it is cut, and the uncancelled return of a slanting wire is at its ends.

    The phase of the path to the front of the cylinder is in the slant range (`nearer`), not in T, since it depends on
    the frequency.

    Parameters
    ----------
    nodes : of the wires
    wires : wires to which the nodes belong
    wavelength : m

    Notes
    -----
    The cylinder's series is evaluated at the tilt whose cosine is the geometric mean of those of the incident and the
    scattered direction (reciprocal; exact on the cone of specular directions and, except for the TE current along the
    axis, in backscatter). Ignores effects of the ends (reflected currents, resonances of wires shorter than a few
    wavelengths, end caps) and shadows cast by wires.

    References
    ----------
    Ruck et al., Radar Cross Section Handbook (1970), chapter 4; Knott, Shaeffer and Tuley, Radar Cross Section (2004).
    """

    mechanism = "wire"

    def __init__(self, nodes: WireNodes, wires: Sequence[WireTarget], wavelength: float) -> None:
        self.n, self.owner = len(nodes.point), nodes.wire
        self.places = vector_rows(nodes.point)
        self.inward = device_array(mi.Float, nodes.inward.astype(np.float32))
        keys = [(wire.radius, wire.permittivity) for wire in wires]
        kinds = self.kinds = list(dict.fromkeys(keys))
        kind = np.array([kinds.index(key) for key in keys])[nodes.wire]
        self.inside = any(eps is not None for _, eps in kinds)
        rows = np.concatenate([nodes.axis, nodes.step[:, None]], axis=1).astype(np.float32)
        self.wires = device_array(mi.Float, rows)
        self.sides = device_array(
            mi.Float,
            np.stack([nodes.sides.sum(axis=1), nodes.sides @ [1.0, -1.0]], axis=1).astype(np.float32),
        )
        self.kind = device_array(mi.UInt32, kind.astype(np.uint32))
        self.radius = device_array(mi.Float, np.array([radius for radius, _ in kinds], np.float32))
        self._tabulate(wavelength)

    def at(self, wavelength: float) -> WireScatterers:
        """The same wires at another wavelength, m."""
        other = copy(self)
        other._tabulate(wavelength)
        return other

    def _tabulate(self, wavelength: float) -> None:
        tables = [cylinder_table(2.0 * np.pi * radius / wavelength, eps) for radius, eps in self.kinds]
        sizes = [table.values.shape[0] * table.values.shape[1] for table in tables]
        first = np.concatenate([[0], np.cumsum(sizes)[:-1]])
        shape = np.array(
            [[start, t.n_tilts, t.n_azimuths, 0] for start, t in zip(first, tables, strict=True)], np.uint32
        )
        self.shapes = device_array(mi.UInt32, shape)
        self.table = device_array(mi.Float, np.concatenate([t.values.reshape(-1, NUMBERS) for t in tables]))

    def point(self, index: mi.UInt32) -> mi.Vector3d:
        """See :class:`Scatterers`."""
        return dr.gather(mi.Vector3d, self.places, index)

    def departure(
        self, index: mi.UInt32, point: mi.Vector3f, direction: mi.Vector3f, clearance: mi.Float
    ) -> mi.Vector3f:
        """Start of a shadow ray, m; at an end it lies within the wire: ground at a post's foot does not hide it."""
        return point + dr.gather(mi.Vector3f, self.inward, index) + direction * clearance

    def amplitude(
        self,
        kernel: Kernel,
        index: mi.UInt32,
        incident: Leg,
        scattered: Leg,
        e: field.ComplexVector,
        q: field.ComplexVector,
    ) -> mi.Complex2f:
        """See :class:`Scatterers`."""
        axis, step = self._axis_and_step(index)
        d, s = -incident.to_antenna, scattered.to_antenna
        legs = [_WireLeg.of(axis, v) for v in (d, s)]
        mm, ee, me = self._series(index, axis, legs)
        filled = self._spline(index, (dr.dot(d, axis) - dr.dot(s, axis)) * step * kernel.constants.wavenumber)
        (t_i, p_i), (t_s, p_s) = ((leg.along, leg.across) for leg in legs)
        tm_in, te_in, tm_out, te_out = (
            field.dot(e, t_i),
            field.dot(e, p_i),
            field.dot(q, t_s),
            field.dot(q, p_s),
        )
        value = mm * tm_in * tm_out + ee * te_in * te_out
        if me is not None:
            value += me * (0.5 * dr.dot(d + s, axis)) * (tm_out * te_in - te_out * tm_in)
        return value * filled * (step * (2.0 / float(np.sqrt(np.pi))))

    def _spline(self, index: mi.UInt32, y: mi.Float) -> mi.Complex2f:
        """Phase integral F of a node for the phase y over half its hat: over both sides, or over one at an end."""
        sides = dr.gather(mi.Vector2f, self.sides, index)
        half = 0.5 * y
        ratio = dr.select(dr.abs(half) > 1e-3, dr.sin(half) / half, 1.0 - dr.square(half) / 6.0)
        y2 = dr.square(y)
        # (y - sin y) / y^2 without its cancellation
        odd = dr.select(
            dr.abs(y) > 0.3, (y - dr.sin(y)) / y2, y * (1.0 / 6.0 - y2 * (1.0 / 120.0 - y2 / 5040.0))
        )
        return mi.Complex2f(0.5 * dr.square(ratio) * sides.x, -odd * sides.y)

    def _series(
        self, index: mi.UInt32, axis: mi.Vector3f, legs: Sequence[_WireLeg]
    ) -> tuple[mi.Complex2f, mi.Complex2f, mi.Complex2f | None]:
        """Coefficients TM, TE and TE to TM (over the sine of the tilt), cubic in azimuth and linear in tilt."""
        kind = dr.gather(mi.UInt32, self.kind, index)
        shape = dr.gather(mi.Vector4u, self.shapes, kind)
        cosine = dr.sqrt(legs[0].cosine * legs[1].cosine)
        azimuth = _azimuth(axis, legs)
        x = dr.abs(azimuth) / dr.pi * mi.Float(shape.z - 1)
        y = dr.acos(dr.clip(cosine, 0.0, 1.0)) * (2.0 / dr.pi) * mi.Float(shape.y - 1)
        column, row = dr.minimum(mi.UInt32(x), shape.z - 2), dr.minimum(mi.UInt32(y), shape.y - 2)
        u, v = x - mi.Float(column), y - mi.Float(row)
        # Lagrange's cubic through four neighbouring nodes
        weights = (
            -u * (u - 1.0) * (u - 2.0) / 6.0,
            (u + 1.0) * (u - 1.0) * (u - 2.0) * 0.5,
            -(u + 1.0) * u * (u - 2.0) * 0.5,
            (u + 1.0) * u * (u - 1.0) / 6.0,
        )
        width = shape.z + 2
        packets = NUMBERS // 4 if self.inside else 1
        sums = [dr.zeros(mi.Vector4f) for _ in range(packets)]
        for i, of_row in enumerate((1.0 - v, v)):
            first = shape.x + (row + i) * width + column
            for j, weight in enumerate(weights):
                for k in range(packets):
                    node = dr.gather(mi.Vector4f, self.table, (first + j) * (NUMBERS // 4) + k)
                    sums[k] += node * (weight * of_row)
        mm, ee = mi.Complex2f(sums[0].x, sums[0].y), mi.Complex2f(sums[0].z, sums[0].w)
        if not self.inside:
            return mm, ee, None
        odd = dr.select(azimuth < 0.0, -1.0, 1.0)
        return mm, ee, mi.Complex2f(sums[1].x, sums[1].y) * odd

    def _axis_and_step(self, index: mi.UInt32) -> tuple[mi.Vector3f, mi.Float]:
        """Unit vector along the wire of a node, and distance to its neighbours, m."""
        row = dr.gather(mi.Vector4f, self.wires, index)
        return mi.Vector3f(row.x, row.y, row.z), row.w

    def nearer(self, index: mi.UInt32, incident: Leg, scattered: Leg) -> mi.Float:
        """Distance of the wire's front surface before its axis, m: its radius at normal incidence."""
        axis, _ = self._axis_and_step(index)
        legs = [_WireLeg.of(axis, v) for v in (-incident.to_antenna, scattered.to_antenna)]
        azimuth = _azimuth(axis, legs)
        radius = dr.gather(mi.Float, self.radius, dr.gather(mi.UInt32, self.kind, index))
        return radius * dr.sqrt(legs[0].cosine * legs[1].cosine) * dr.abs(dr.sin(0.5 * azimuth))


@dataclass(frozen=True, eq=False)
class _WireLeg:
    """Wave at a wire: unit vectors in and across the plane of axis and ray, and the cosine of the tilt."""

    along: mi.Vector3f
    across: mi.Vector3f
    cosine: mi.Float

    @staticmethod
    def of(axis: mi.Vector3f, direction: mi.Vector3f) -> _WireLeg:
        across = dr.cross(axis, direction)
        cosine = dr.norm(across)
        # along the axis the plane is undefined, and nothing is scattered
        across = across * dr.rcp(dr.maximum(cosine, 1e-6))
        return _WireLeg(dr.cross(direction, across), across, cosine)


def _azimuth(axis: mi.Vector3f, legs: Sequence[_WireLeg]) -> mi.Float:
    """Angle about the axis from the incident to the scattered direction, rad."""
    turn = dr.dot(legs[0].across, legs[1].across)
    side = dr.dot(dr.cross(legs[0].across, legs[1].across), axis)
    return dr.atan2(side, turn)


class WireRows(SourceKind):
    """Wires as rows of nodes."""

    name, rank = "wires", 10

    def make_source(self, site: Site) -> Source | None:
        """See :class:`SourceKind`."""
        wires = wires_of(site.scene.scatterers)
        if not wires:
            return None
        nodes = cut_wires(wires, _step(site))
        nodes = nodes.weigh(site.shares(nodes.point))
        if not len(nodes.point):
            return None
        return PointSource(WireScatterers(nodes, wires, site.wavelength), most_bounces(site.scene))

    def estimate_cost(self, site: Site, sub_bands: int) -> Expected | None:
        """Cost from the number of nodes, and of tables for each thickness and material at each frequency."""
        wires = wires_of(site.scene.scatterers)
        if not wires:
            return None
        step, wavenumber = _step(site), 2.0 * np.pi / site.wavelength
        nodes = sum(wire.length / step + 2.0 for wire in wires)
        tables = [
            table_size(wavenumber * radius, eps)
            for radius, eps in {(wire.radius, wire.permittivity) for wire in wires}
        ]
        terms = sum(tilts * azimuths * orders for tilts, azimuths, orders in tables)
        numbers = max(tilts * azimuths for tilts, azimuths, _ in tables)
        making = nodes * NODE_LAID + sub_bands * terms * NUMBER_LAID
        return Expected(nodes, making, NODE_TRACED, nodes * NODE_BYTES + numbers * NUMBER_BYTES)


def _step(site: Site) -> float:
    """Largest distance between the nodes of wires, m; infinite in the far field, where a wire is one piece."""
    return longest_step(*site.cells, site.distance, site.wavelength)


SOURCES.register(WireRows())
