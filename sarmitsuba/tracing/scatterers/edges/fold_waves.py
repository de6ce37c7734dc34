"""Waves that a fold between two metal faces sends beyond rays, from its section solved by moments."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from sarmitsuba.core.arrays import F64, unit_rows
from sarmitsuba.effects.fold_sections import Folds, fold_grids
from sarmitsuba.machine.backend import device_array, dr, mi
from sarmitsuba.tracing.derivatives.hooks import derivatives_of
from sarmitsuba.tracing.kernel import field
from sarmitsuba.tracing.kernel.intersector import query_ray
from sarmitsuba.tracing.kernel.leg import Leg
from sarmitsuba.tracing.kernel.source import Scatterers
from sarmitsuba.tracing.kernel.state import Kernel
from sarmitsuba.tracing.scatterers.edges.diffraction import LONGEST
from sarmitsuba.tracing.scatterers.edges.edge_currents import sinc

if TYPE_CHECKING:
    from sarmitsuba.tracing.derivatives.leg_tangents import Shift

# least sine of the angle between a fold and the line of sight
LEAST = 1e-3


class FoldWaves(Scatterers):
    r"""Waves of folds in short pieces: section less rays, as tabulated, over the length, with its phase integral.

    .. math::
        \sqrt\sigma = l\, \mathrm{sinc}(k l \hat s \cdot \hat t) \sqrt{2 / \lambda'}
        \left[ (\mathbf q \cdot \hat s_s)(\mathbf e \cdot \hat s_s) D_s
        + (\mathbf q \cdot \hat s_h)(\mathbf e \cdot \hat s_h) D_h \right]

    with unit vectors across the line of sight, along the fold and across it. Between the grids' entries by a cubic in
    the angle across the fold and linearly in the lean along it; zero beyond them.

    Parameters
    ----------
    folds : of the scene
    wavelength : m
    directions : (m, 3) float64, unit vectors to the antenna, which the grids cover
    longest : m, bound on the length of a piece

    Notes
    -----
    Backscatter alone. All waves have the range of the fold, and both faces are rectangles: waves that their ends along
    the fold send is missing. Ignores other bodies within the fold but for its visibility.
    """

    mechanism = "edge"

    def __init__(self, folds: Folds, wavelength: float, directions: F64, longest: float) -> None:
        self._folds, self._wavelength, self._directions, self._longest = (
            folds,
            wavelength,
            directions,
            longest,
        )
        self._grids = fold_grids(folds, wavelength, directions)
        longest = max(longest, LONGEST * wavelength)
        pieces = [folds.of(np.array([grid.row])).cut(longest) for grid in self._grids]
        self.n = sum(piece.n for piece in pieces)
        self.middle = np.concatenate([piece.middle for piece in pieces] or [np.zeros((0, 3))])
        self._pieces = pieces

    def point(self, index: mi.UInt32) -> mi.Vector3d:
        """See :class:`sarmitsuba.tracing.kernel.source.Scatterers`."""
        return dr.gather(mi.Vector3d, self._middle, index)

    def at(self, wavelength: float) -> FoldWaves:
        """See :class:`sarmitsuba.tracing.kernel.source.Scatterers`: solved anew."""
        return FoldWaves(self._folds, wavelength, self._directions, self._longest)

    @cached_property
    def _middle(self) -> mi.Float64:
        return device_array(mi.Float64, self.middle)

    @cached_property
    def _frame(self) -> mi.Float:
        """Five rows of four of each piece: bisector, length; side, first entry; direction, angles; grid; leans."""
        rows = []
        begin = 0
        for piece, grid in zip(self._pieces, self._grids, strict=True):
            middle, side = piece.arms.sum(axis=1), piece.arms[:, 1] - piece.arms[:, 0]
            middle = unit_rows(middle)
            side = unit_rows(side)
            places = [grid.first, 1.0 / grid.step, grid.lean_first, 1.0 / grid.lean_step]
            table = np.zeros((piece.n, 5, 4))
            table[:, 0, :3], table[:, 0, 3] = middle, piece.length
            table[:, 1, :3], table[:, 1, 3] = side, begin
            table[:, 2, :3], table[:, 2, 3] = piece.along, grid.n
            table[:, 3], table[:, 4, 0] = places, grid.n_leans
            rows.append(table.reshape(-1, 4))
            begin += grid.n_leans * grid.n
        return device_array(mi.Float, np.concatenate(rows).astype(np.float32))

    @cached_property
    def _values(self) -> mi.Float:
        """Real and imaginary part along and across of all entries."""
        solved = [grid.solve(self._folds, self._wavelength) for grid in self._grids]
        flat = [np.stack([v.real, v.imag], axis=-1).reshape(-1, 4) for v in solved]
        return device_array(mi.Float, np.concatenate(flat).astype(np.float32))

    def _row(self, index: mi.UInt32, i: int) -> mi.Vector4f:
        return dr.gather(mi.Vector4f, self._frame, index * 5 + i)

    def shifts(
        self, kernel: Kernel, index: mi.UInt32, incident: Leg, scattered: Leg
    ) -> Sequence[Shift | None]:
        """Velocities of the folds of shapes that are displaced as a whole; their waves are kept."""
        carried = derivatives_of(kernel).displacements
        if all(offset is None for offset in carried.offset):
            return ()
        bisector = self._row(index, 0)
        inside = mi.Vector3f(bisector.x, bisector.y, bisector.z)
        side = self._row(index, 1)
        middle = self.point(index)
        step = 4.0 * kernel.constants.clearance
        towards = mi.Vector3f(side.x, side.y, side.z)
        found = kernel.scene.mi_scene.ray_intersect_preliminary(
            query_ray(mi.Vector3f(middle) + inside * step, towards), coherent=True, active=mi.Bool(True)
        )
        there, face = found.is_valid(), found.prim_index
        shifts: list[Shift | None] = []
        for k, offset in enumerate(carried.offset):
            movement = carried.movement(k, face, middle, there)
            if offset is None or movement is None:
                shifts.append(None)
            else:
                shifts.append((movement.velocity, mi.Float(0.0)))
        return shifts

    def amplitude(
        self,
        kernel: Kernel,
        index: mi.UInt32,
        incident: Leg,
        scattered: Leg,
        e: field.ComplexVector,
        q: field.ComplexVector,
    ) -> mi.Complex2f:
        """See the class."""
        rows = [self._row(index, i) for i in range(5)]
        inside, side, along = (mi.Vector3f(row.x, row.y, row.z) for row in rows[:3])
        to = incident.to_antenna
        lean = dr.dot(to, along)
        sine = dr.sqrt(dr.maximum(1.0 - dr.square(lean), LEAST**2))
        soft = (along - to * lean) / sine
        hard = dr.cross(to, soft)
        place = (dr.atan2(dr.dot(to, side), dr.dot(to, inside)) - rows[3].x) * rows[3].y
        level = ((1.0 - sine) - rows[3].z) * rows[3].w
        n, n_leans = rows[2].w, rows[4].x
        held = (place >= 1.0) & (place < n - 2.0) & (level > -1.0) & (level < n_leans)
        values = self._between(mi.UInt32(rows[1].w), place, level, n, n_leans, held)
        d_soft, d_hard = mi.Complex2f(values.x, values.y), mi.Complex2f(values.z, values.w)
        total = d_soft * field.dot(e, soft) * field.dot(q, soft) + d_hard * field.dot(e, hard) * field.dot(
            q, hard
        )
        length = rows[0].w
        return total * (length * sinc(kernel.constants.wavenumber * length * lean))

    def _between(
        self,
        begin: mi.UInt32,
        place: mi.Float,
        level: mi.Float,
        n: mi.Float,
        n_leans: mi.Float,
        held: mi.Bool,
    ) -> mi.Vector4f:
        """Entries of the grids, cubic in the angle and linear in the lean; zero beyond them."""
        place = dr.select(held, place, 1.0)
        low = dr.floor(place)
        t = place - low
        cubic = (
            ((2.0 - t) * t - 1.0) * t * 0.5,
            ((3.0 * t - 5.0) * t * t + 2.0) * 0.5,
            ((4.0 - 3.0 * t) * t + 1.0) * t * 0.5,
            (t - 1.0) * t * t * 0.5,
        )
        row = dr.floor(level)
        share = level - row
        total = mi.Vector4f(0.0)
        for i, weight in enumerate((1.0 - share, share)):
            at = row + float(i)
            there = held & (at >= 0.0) & (at <= n_leans - 1.0)
            first = begin + mi.UInt32(dr.select(there, at, 0.0)) * mi.UInt32(n) + mi.UInt32(low) - 1
            for j, c in enumerate(cubic):
                total += dr.gather(mi.Vector4f, self._values, first + j, there) * (c * weight)
        return total
