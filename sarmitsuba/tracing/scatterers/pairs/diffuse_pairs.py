r"""Echoes of double diffuse scattering: antenna, A, B, antenna, and the reversed path.

With random phases the sum over all pairs is complex Gaussian, and only its mean power is a property of the scene: a
random choice of pairs has to preserve it. A pair {A, B} returns

.. math:: s_{AB} + s_{BA}, \quad
    s_{AB} = \frac{\sqrt{\sigma^0_A \sigma^0_B}}{\sqrt{4 \pi} r} \, \mathbf q \cdot D_B D_A \mathbf e

for each m^2 of both ends. Both orders are one path in both directions: with one antenna their lengths are equal, and
by reciprocity :math:`s_{BA}` is :math:`s_{AB}` of the transposed channel. So co-polar channels have twice the power
of two uncorrelated paths (coherent backscatter enhancement), and HV = VH. Pairs
drawn with the density p (:mod:`sarmitsuba.tracing.scatterers.pairs.pair_search`) return

.. math:: S = \sum_{drawn} g \, (s_{AB} + s_{BA}) / \sqrt p, \qquad
    \langle |S|^2 \rangle = \int_{\{A, B\}} p \, |s_{AB} + s_{BA}|^2 / p

with a fixed random phase g of each pair: an unbiased estimate of the power of all pairs. The weight :math:`1 / p`, as
for a sum of fields, would give :math:`\int |s|^2 / p` instead, which grows as fewer pairs are drawn.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from sarmitsuba.machine.backend import device_array, dr, mi
from sarmitsuba.radar.polarisation import linear_parts
from sarmitsuba.tracing.derivatives.hooks import derivatives_of
from sarmitsuba.tracing.kernel import field
from sarmitsuba.tracing.kernel.antenna_weight import fade
from sarmitsuba.tracing.kernel.diffuse_return import mix_terms
from sarmitsuba.tracing.kernel.intersector import leave_surface
from sarmitsuba.tracing.kernel.kernel import TraceCounts
from sarmitsuba.tracing.kernel.leg import Leg, Surroundings, pattern_gain, straight_leg
from sarmitsuba.tracing.kernel.propagation import antenna_of
from sarmitsuba.tracing.kernel.scattering_matrix import ScatteringMatrix, speckle_coefficients
from sarmitsuba.tracing.kernel.scene_tables import MATERIAL_MASK
from sarmitsuba.tracing.kernel.source import MAX_LANES, Part
from sarmitsuba.tracing.kernel.speckle import mix
from sarmitsuba.tracing.kernel.state import SCATTERER, Contribution, Kernel
from sarmitsuba.tracing.kernel.table_rows import FaceRow, MaterialRow
from sarmitsuba.tracing.kernel.temporal import Age
from sarmitsuba.tracing.scatterers.pairs.pair_search import FACING, SurfacePairs

if TYPE_CHECKING:
    from sarmitsuba.effects.flags import KernelFlags
    from sarmitsuba.radar.antenna import Antenna
    from sarmitsuba.tracing.kernel.kernel import Accumulator, LaneArrays
    from sarmitsuba.tracing.kernel.launch import LaunchGrid, PulseBatch


@dataclass(frozen=True, eq=False)
class _PairEnd:
    """Position and surface of one scatterer of a pair."""

    point: mi.Vector3d
    normal64: mi.Vector3d
    normal: mi.Vector3f
    material: mi.UInt32
    properties: MaterialRow
    random: list[mi.Complex2f]


@dataclass(frozen=True, eq=False)
class _StruckEnd:
    """One scatterer of a pair with its incident wave.

    See :class:`sarmitsuba.tracing.kernel.scattering_matrix.Struck`.
    """

    material: mi.UInt32
    normal: mi.Vector3f
    direction: mi.Vector3f
    properties: MaterialRow


@dataclass(frozen=True, eq=False)
class _LitEnd:
    """Leg from one scatterer of a pair to an antenna, and the amplitude of the launch window there."""

    leg: Leg
    fade: mi.Float


class PairSource:
    """Echoes of pairs of diffuse scatterers; a :class:`sarmitsuba.tracing.kernel.source.Source`.

    Parameters
    ----------
    pairs : drawn for the scene

    Notes
    -----
    Ignores three and more diffuse scatterers in a row, mirrors between, before and after the two, and near-field
    coupling within a wavelength. Both scatterers are surfaces at rest. The random phase of a pair is independent of
    the speckle of its two cells, as for surfaces rough against the wavelength.
    """

    mechanism: ClassVar[str] = "diffuse pair"
    drawn: ClassVar[str] = "pairs of diffuse scatterers"

    # kinds of parameters whose derivatives are not known: shapes that move have other pairs
    unknown: ClassVar[frozenset[str]] = frozenset({"materials", "shapes"})

    def __init__(self, pairs: SurfacePairs) -> None:
        self.n, self.face = pairs.n, pairs.face
        self.places = device_array(mi.Float64, _rows(pairs))
        self.faces = device_array(mi.UInt32, pairs.face.astype(np.uint32))
        self.key = device_array(mi.UInt32, pairs.key)

    def parts(self, rays: Sequence[LaunchGrid], n_pulses: int) -> Sequence[Part]:
        """Launches for a batch of pulses, as few as memory allows; the window of the first lattice lights all pairs."""
        step = max(1, MAX_LANES // n_pulses)
        return [Part(rays[0], first, min(step, self.n - first)) for first in range(0, self.n, step)]

    def record(
        self, part: Part, kernel: Kernel, antenna: Antenna, accumulator: Accumulator
    ) -> tuple[TraceCounts, LaneArrays]:
        """See :class:`sarmitsuba.tracing.kernel.source.Source`."""
        pulses, receiver = kernel.pulses, kernel.pulses.receiver
        number = dr.arange(mi.UInt32, part.count * pulses.n_pulses)
        count = dr.opaque(mi.UInt32, part.count)
        pulse = number // count
        index = number - pulse * count + dr.opaque(mi.UInt32, part.first)
        a, b, weight = self._ends(kernel, index)
        out_a, out_b = (_leg_to_antenna(kernel, pulses, pulse, end) for end in (a, b))
        home_a, home_b = out_a, out_b
        if receiver is not None:
            home_a, home_b = (_leg_to_antenna(kernel, receiver, pulse, end) for end in (a, b))
        weight = weight * kernel.constants.amplitude
        one = self._path(kernel, antenna, pulse, (a, out_a), (b, home_b), weight)
        added = accumulator.begin()
        if receiver is None:
            # the reversed path has the same length, and the transposed channel
            other = self._path(kernel, antenna, pulse, (b, out_b), (a, home_a), weight)
            both = tuple(x + y for x, y in zip(one.amplitudes, other.amplitudes, strict=True))
            added = accumulator.add(added, replace(one, amplitudes=both))
            contributions = dr.select(one.active, mi.UInt32(1), 0)
        else:
            other = self._path(kernel, antenna, pulse, (b, out_b), (a, home_a), weight)
            added = accumulator.add(accumulator.add(added, one), other)
            contributions = dr.select(one.active, mi.UInt32(1), 0) + dr.select(other.active, mi.UInt32(1), 0)
        return TraceCounts(dr.zeros(mi.UInt32, part.count * pulses.n_pulses), contributions), added

    def scatterers_of(self, part: Part) -> PairSource:
        """The pairs themselves."""
        return self

    def at(self, wavelength: float) -> PairSource:
        """The same pairs at another wavelength, m: itself, since the kernel's tables hold the material's properties."""
        return self

    def _ends(self, kernel: Kernel, index: mi.UInt32) -> tuple[_PairEnd, _PairEnd, mi.Float]:
        """Both scatterers of a pair, and its weight."""
        rows = [dr.gather(mi.Vector4d, self.places, 4 * index + i) for i in range(4)]
        faces = dr.gather(mi.Vector2u, self.faces, index)
        key = dr.gather(mi.UInt32, self.key, index) + kernel.constants.seed
        # a pair has one random phase; its level is that of the mean power
        flags = replace(kernel.flags, speckle=False)
        ends, weight = [], mi.Float(rows[0][3])
        for i, face in enumerate((faces.x, faces.y)):
            word = FaceRow.of(kernel.scene.face_info, face).material_bits
            place, normal = rows[2 * i], rows[2 * i + 1]
            point, normal64 = (mi.Vector3d(x[0], x[1], x[2]) for x in (place, normal))
            word, factor = kernel.scene.at_place(
                face, word, point, normal64, kernel.constants.seed, mi.Bool(True)
            )
            weight *= factor
            properties = MaterialRow.of(kernel.scene.material_table, word & MATERIAL_MASK)
            age = Age.of(kernel, kernel.scene.change_table, word & MATERIAL_MASK)
            key_here = mix(key ^ (0x1B873593 * (i + 1)))
            ends.append(
                _PairEnd(
                    point=point,
                    normal64=normal64,
                    normal=mi.Vector3f(normal64),
                    material=word,
                    properties=properties,
                    random=speckle_coefficients(key_here, properties.cross_polar_ratio, flags, age),
                )
            )
        return ends[0], ends[1], weight

    def _path(
        self,
        kernel: Kernel,
        antenna: Antenna,
        pulse: mi.UInt32,
        begin: tuple[_PairEnd, _LitEnd],
        end: tuple[_PairEnd, _LitEnd],
        weight: mi.Float,
    ) -> Contribution:
        """Length, range rate and amplitudes of the path over both scatterers in one order."""
        flags, constants = kernel.flags, kernel.constants
        (a, lit), (b, home) = begin, (end[0], end[1].leg)
        out = lit.leg
        across = mi.Vector3f(b.point - a.point)
        r = dr.norm(across)
        s = across / r
        # needs both planes of incidence, also in kernels of backscatter alone
        planes = replace(flags, multi_bounce=True)
        never = mi.Bool(False)
        first = ScatteringMatrix(
            kernel.scene, _StruckEnd(a.material, a.normal, -out.to_antenna, a.properties), s, planes, never
        )
        second = ScatteringMatrix(
            kernel.scene, _StruckEnd(b.material, b.normal, s, b.properties), home.to_antenna, planes, never
        )
        factor = weight * constants.spreading_loss(out.length, home.length) * lit.fade
        factor *= pattern_gain(kernel, antenna, pulse, out.leaving, home.leaving)
        closed = _linear(flags)
        arrival = leave_surface(mi.Vector3f(b.point), b.normal, s, constants.clearance)
        u, v = mi.coordinate_system(s)
        length = mi.Float64(dr.norm(b.point - a.point))
        letters = dict.fromkeys(channel[0] for channel in closed)
        fields = []
        for letter in letters:
            e = out.sent(letter)
            zu, zv = (mix_terms(first.between(q, e), a.random) for q in (u, v))
            fields.append(field.add(field.scale(zu, u), field.scale(zv, v)))
        passed, shift = Surroundings.within(kernel).passed(arrival, -s, r, out.seen, tuple(fields))
        between = dict(zip(letters, passed, strict=True))
        if shift is not None:  # the delay in slabs between the two
            length = length - dr.dot(mi.Vector3d(s), mi.Vector3d(shift))
        values = [
            mix_terms(second.between_fields(home.sent(channel[1]), between[channel[0]]), b.random) * factor
            for channel in closed
        ]
        echo = Contribution(
            kind=mi.UInt32(SCATTERER),
            order=mi.UInt32(2),
            pulse=pulse,
            slant_range=0.5 * (out.length + length + home.length),
            range_rate=0.5 * (out.rate + home.rate),
            amplitudes=tuple(field.pick_recorded(closed, values, flags.channels)),
            active=out.seen & home.seen,
            point=0.5 * (a.point + b.point),
        )
        materials = (a.material & MATERIAL_MASK, b.material & MATERIAL_MASK)
        return derivatives_of(kernel).at_echo(kernel, antenna, echo, (out, home), materials=materials)


def _rows(pairs: SurfacePairs) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    """(n, 4, 4) float64 table of pairs: point of an end and the weight, its normal and a zero, for both ends."""
    rows = np.zeros((pairs.n, 4, 4))
    rows[:, 0::2, :3], rows[:, 1::2, :3] = pairs.point, pairs.normal
    rows[:, 0, 3] = pairs.weight
    return rows


def _leg_to_antenna(kernel: Kernel, pulses: PulseBatch, pulse: mi.UInt32, end: _PairEnd) -> _LitEnd:
    """Leg between one scatterer of a pair and the antenna of a pulse."""
    position, velocity = antenna_of(pulses, pulse)
    clearance = kernel.constants.clearance

    def departure(to: mi.Vector3f) -> tuple[mi.Vector3f, mi.Bool]:
        start = leave_surface(mi.Vector3f(end.point), end.normal, -to, clearance)
        return start, dr.dot(to, end.normal) > FACING

    leg = straight_leg(Surroundings.within(kernel), end.point, departure, position, velocity)
    return _LitEnd(leg, _window(kernel, pulse, position, -leg.to_antenna64))


def _window(kernel: Kernel, pulse: mi.UInt32, position: mi.Vector3d, leaving: mi.Vector3d) -> mi.Float:
    """Amplitude of the launch window for a ray that leaves the antenna in a given direction."""
    grid, frame = kernel.grid, kernel.pulses.frame
    if not kernel.flags.taper:
        return mi.Float(1.0)
    plane = pulse if frame.center.shape[0] > 1 else dr.zeros(mi.UInt32, 1)
    center, x, y = (
        dr.gather(mi.Vector3d, device_array(mi.Float64, rows), plane)
        for rows in (frame.center, frame.axis_x, frame.axis_y)
    )
    across = dr.cross(x, y)
    there = position - center + leaving * (dr.dot(center - position, across) / dr.dot(leaving, across))
    gx, gy = mi.Float(dr.dot(there, x)), mi.Float(dr.dot(there, y))
    # no rays start beyond the taper, or, without a taper, beyond the window
    lit = (dr.abs(gx) <= dr.opaque(mi.Float, grid.half_x + grid.taper)) & (
        dr.abs(gy) <= dr.opaque(mi.Float, grid.half_y + grid.taper)
    )
    return dr.select(lit, fade(gx, grid.half_x, grid.taper) * fade(gy, grid.half_y, grid.taper), 0.0)


def _linear(flags: KernelFlags) -> tuple[str, ...]:
    """Linear channels (HH, HV, ...) from which the recorded channels are formed."""
    return tuple(dict.fromkeys(part for c in flags.channels for _, part in linear_parts(c)))
