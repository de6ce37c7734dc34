"""Stages of waves that go through slabs: on straight legs that are known, and as branches of a ray's path.

At a slab a path goes on as two: the mirrored ray waits in memory of the lane's own while the one that goes through is
followed to its end. So every path is traced once, the part that two paths have in common as well, and lanes without
slabs do no more than before.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, is_dataclass, replace
from typing import TYPE_CHECKING, Any

from sarmitsuba.backend import dr, mi
from sarmitsuba.trace import field
from sarmitsuba.trace.scene_tables import MATERIAL_MASK
from sarmitsuba.trace.slab_coefficients import SlabFactors, slab

if TYPE_CHECKING:
    from sarmitsuba.trace.field import ComplexVector
    from sarmitsuba.trace.scene_tables import TraceScene
    from sarmitsuba.trace.slab_coefficients import SlabTables
    from sarmitsuba.trace.state import Hit, Kernel, RayState

# slabs that a path may go through on its way to its last hit; on the scattered leg there is no bound
MOST_SLABS = 6
# power over that at launch down to which both parts of a path that parts at a slab are followed
LEAST_POWER = 1e-12


def along(
    scene: TraceScene,
    wavenumber: mi.Float,
    clearance: mi.Float,
    start: mi.Vector3f,
    direction: mi.Vector3f,
    distance: mi.Float,
    active: mi.Bool,
    vectors: tuple[ComplexVector, ...],
) -> tuple[tuple[ComplexVector, ...], mi.Vector3f]:
    """Complex vectors at the start of a straight leg through slabs, from those at its end, and the end's shift, m.

    Seen through slabs the end of the leg is by the shift elsewhere: farther by the delay, and aside.

    Parameters
    ----------
    scene : with slabs
    wavenumber, clearance : rad/m; m, how far a wave starts off a facet that it leaves
    start, direction, distance : m, unit vector, m; of the leg
    active : lanes that have it
    vectors : of waves that come along it, or receiving ones: what slabs do is a symmetric dyad
    """
    slabs = scene.slabs
    assert slabs is not None
    # beyond the scene there is nothing; order matters where the planes of incidence of two slabs differ
    length = dr.minimum(distance, _leaving(scene, clearance, start, direction))
    towards = -direction

    def some_left(
        left: mi.Float, active: mi.Bool, shift: mi.Vector3f, vectors: tuple[ComplexVector, ...]
    ) -> mi.Bool:
        return active

    def next_slab(
        left: mi.Float, active: mi.Bool, shift: mi.Vector3f, vectors: tuple[ComplexVector, ...]
    ) -> tuple[mi.Float, mi.Bool, mi.Vector3f, tuple[ComplexVector, ...]]:
        query = mi.Ray3f(start + direction * left, towards, left, 0.0, [])
        met = slabs.transmitting.ray_intersect_preliminary(query, coherent=False, active=active)
        active = active & met.is_valid()
        face = dr.gather(mi.UInt32, slabs.transmitting_face, met.prim_index, active)
        row = face * 12
        n = mi.Vector3f(*(dr.gather(mi.Float64, scene.face_table, row + i, active) for i in (3, 7, 11)))
        behind = dr.dot(n, towards) > 0.0
        n = dr.select(behind, -n, n)
        material = dr.gather(mi.Vector4u, scene.face_info, face, active).x & MATERIAL_MASK
        properties = dr.gather(mi.Vector4f, scene.material_table, material, active)
        row_of = dr.gather(mi.Vector4f, slabs.table, material, active)
        factors = slab_factors(properties, row_of, towards, n, behind)
        passed = _behind(vectors, towards, n, factors)
        vectors = tuple(
            tuple(dr.select(active, a, b) for a, b in zip(x, y, strict=True))
            for x, y in zip(passed, vectors, strict=True)
        )
        cosine = dr.maximum(-dr.dot(n, towards), 1e-7)
        step = met.t + _past(slabs, face, behind, active, clearance) / cosine
        left = dr.select(active, left - step, left)
        shift = shift + dr.select(active, _shift(factors, towards, n) / wavenumber, 0.0)
        return left, active & (left > 0.0), shift, vectors

    _, _, shift, vectors = dr.while_loop(
        (length, active, dr.zeros(mi.Vector3f), vectors),
        some_left,
        next_slab,
        labels=("left", "active", "shift", "vectors"),
        label="slabs",
        mode="symbolic",
    )
    return vectors, shift


def _shift(factors: SlabFactors, d: mi.Vector3f, n: mi.Vector3f) -> mi.Vector3f:
    r"""Where a slab puts the source of a wave along ``d``, times the wavenumber, rad.

    .. math:: k \mathbf w = -k \Delta L\, \mathbf d - \frac{\partial \phi}{\partial \cos\theta}
              (\mathbf n + \cos\theta\, \mathbf d)

    with phase :math:`\phi` of T and the normal facing the wave: the path from there to any point near the ray, and
    its change as the point or the antenna moves, are those through the slab.
    """
    return -d * factors.extra - (n - d * dr.dot(d, n)) * factors.aside


def slab_factors(
    properties: mi.Vector4f, row: mi.Vector4f, d: mi.Vector3f, n: mi.Vector3f, behind: mi.Bool
) -> SlabFactors:
    """Factors of a wave along ``d`` at a slab of normal ``n`` that faces it.

    Parameters
    ----------
    properties, row : of the material, of `TraceScene.material_table` and of `SlabTables.table`
    behind : whether ``n`` is the facet's own normal turned round: the wave then meets the coat first
    """
    chi = mi.Complex2f(properties.x, properties.y)
    return slab(dr.maximum(-dr.dot(d, n), 1e-7), chi, row.x, row.y, behind)


@dataclass  # not frozen: part of the loop's state, which Dr.Jit writes to
class Waiting:
    """Paths that branched off at slabs and wait for the lane, and its hits on all its paths.

    Parameters
    ----------
    memory : of the lane's own, one for each array of a ray's state
    count : paths that wait
    hits : so far
    """

    memory: list[Any]
    count: mi.UInt32
    hits: mi.UInt32

    @staticmethod
    def none(ray: RayState) -> Waiting:
        """Room for the paths of rays like this one."""
        memory = [dr.alloc_local(type(x), MOST_SLABS, value=dr.zeros(type(x))) for x in _arrays(ray)]
        # one number per lane from the start: a single one would have all lanes write and read where the first does
        count = dr.zeros(mi.UInt32, dr.width(ray.active))
        return Waiting(memory, count, mi.UInt32(0))


def branched(
    kernel: Kernel, before: RayState, hit: Hit, mirrored: RayState, waiting: Waiting
) -> tuple[RayState, Waiting]:
    """How a lane goes on: through the slab it hit, mirrored, or with a path that waits.

    Parameters
    ----------
    before : the ray as it arrived, before foci are counted
    hit : on a slab or not
    mirrored : the ray behind the mirror; not active after its last bounce
    waiting : paths that branched off before

    Notes
    -----
    Ignores what goes through after ``MOST_SLABS`` slabs. Of a path that parts, a part below ``LEAST_POWER`` is left
    out; where both are, the one that goes through: else paths in a room of slabs are as many as sets of its bounces. A
    tube is not cut at a slab's rim, as at that of a shadow: it goes through or not as its ray does.
    """
    assert before.crossed is not None and hit.slab is not None
    slabs, clearance = _slabs(kernel), kernel.constants.clearance
    d, n = hit.direction, hit.normal
    factors = slab_factors(hit.properties, hit.slab, d, n, hit.behind)
    passed = _behind(before.fields, d, n, factors)
    transmitted = (
        hit.met & (hit.slab.z > 0.5) & (before.crossed < MOST_SLABS) & (_power(passed) > LEAST_POWER)
    )
    step = mi.Vector3d(_shift(factors, d, n) / kernel.constants.wavenumber)
    along_ray = dr.dot(step, hit.direction64)
    aside = mi.Vector3f(step - hit.direction64 * along_ray)
    past = _past(slabs, hit.face, hit.behind, transmitted, clearance) / dr.maximum(-dr.dot(d, n), 1e-7)
    beyond = d * (past if hit.before_facet is None else past + hit.before_facet)
    spread, receiver = before.spread, before.virtual_receiver
    gone = replace(
        before,
        active=transmitted,
        hits=before.hits,
        origin=mi.Vector3f(hit.p) + beyond + aside,
        virtual_antenna=before.virtual_antenna + step,
        virtual_receiver=None if receiver is None else receiver + step,
        spread=None if spread is None else replace(spread, start=spread.start - along_ray),
        fields=passed,
        crossed=before.crossed + 1,
    )
    waits = transmitted & mirrored.active & (_power(mirrored.fields) > LEAST_POWER)
    for memory, array in zip(waiting.memory, _arrays(mirrored), strict=True):
        memory.write(array, waiting.count, active=waits)
    count = waiting.count + dr.select(waits, mi.UInt32(1), 0)
    ray = _chosen(transmitted, gone, mirrored)
    # at its end a path makes room for the last that waits
    ended = ~ray.active & (count > 0)
    count = count - dr.select(ended, mi.UInt32(1), 0)
    stored = _rebuilt(ray, iter([memory.read(count, active=ended) for memory in waiting.memory]))
    ray = _chosen(ended, replace(stored, active=ended), ray)
    return ray, replace(waiting, count=count, hits=waiting.hits + dr.select(hit.active, mi.UInt32(1), 0))


def _slabs(kernel: Kernel) -> SlabTables:
    slabs = kernel.scene.slabs
    assert slabs is not None
    return slabs


def _behind(
    vectors: Sequence[ComplexVector], d: mi.Vector3f, n: mi.Vector3f, factors: SlabFactors
) -> tuple[ComplexVector, ...]:
    h = field.incidence_basis(d, n)
    return tuple(field.reflect_field(e, d, d, h, factors.t_te, factors.t_tm) for e in vectors)


def _power(vectors: Sequence[ComplexVector]) -> mi.Float:
    """Largest squared norm of any of some complex vectors."""
    power = mi.Float(0.0)
    for re, im in vectors:
        power = dr.maximum(power, dr.squared_norm(re) + dr.squared_norm(im))
    return power


def _past(
    slabs: SlabTables, face: mi.UInt32, behind: mi.Bool, active: mi.Bool, clearance: mi.Float
) -> mi.Float:
    """How far along the normal a wave goes on from a face that it met: past the other face of a box, if it is one."""
    gap = dr.gather(mi.Float, slabs.gap, face, active)
    return dr.maximum(dr.select(behind, gap, -gap), 0.0) + clearance


def _leaving(scene: TraceScene, clearance: mi.Float, start: mi.Vector3f, d: mi.Vector3f) -> mi.Float:
    """How far from a place in the scene along ``d`` its bounds end, m."""
    low, high = (mi.Vector3f(*(dr.opaque(mi.Float, float(x)) for x in corner)) for corner in scene.bounds)
    inverse = 1.0 / dr.select(dr.abs(d) > 1e-12, d, 1e-12)
    far = dr.maximum((low - start) * inverse, (high - start) * inverse)
    return dr.maximum(dr.minimum(dr.minimum(far.x, far.y), far.z), 0.0) + clearance


def _arrays(value: Any) -> list[Any]:
    """Arrays of a ray's state but ``active``, which all that wait have in common, and the lane's own count."""
    if value is None:
        return []
    if is_dataclass(value):
        parts = [getattr(value, f.name) for f in fields(value) if f.name not in _OF_THE_LANE]
    elif isinstance(value, tuple):
        parts = list(value)
    else:
        return [value]
    return [array for part in parts for array in _arrays(part)]


_OF_THE_LANE = ("active", "contributions")


def _rebuilt(like: Any, arrays: Any) -> Any:
    """A state of the same make with other arrays."""
    if like is None:
        return None
    if is_dataclass(like) and not isinstance(like, type):
        return replace(
            like,
            **{
                f.name: _rebuilt(getattr(like, f.name), arrays)
                for f in fields(like)
                if f.name not in _OF_THE_LANE
            },
        )
    if isinstance(like, tuple):
        return tuple(_rebuilt(x, arrays) for x in like)
    return next(arrays)


def _chosen(condition: mi.Bool, a: RayState, b: RayState) -> RayState:
    """``a`` in the lanes where the condition holds, else ``b``."""
    pairs = zip(_arrays(a), _arrays(b), strict=True)
    chosen = _rebuilt(b, iter([dr.select(condition, x, y) for x, y in pairs]))
    ray: RayState = replace(
        chosen,
        active=dr.select(condition, a.active, b.active),
        contributions=b.contributions,
    )
    return ray


__all__ = ["MOST_SLABS", "Waiting", "along", "branched", "slab_factors"]
