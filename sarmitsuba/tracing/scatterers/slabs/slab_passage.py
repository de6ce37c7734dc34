"""Transmission through slabs: along straight legs, and as branches of a ray's path.

At a slab a path splits in two: the reflected ray is stored in the lane's memory while the transmitted ray is traced to
its end. So common parts of paths are traced once, and lanes that meet no slab cost no more.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, is_dataclass, replace
from typing import TYPE_CHECKING, Any

from sarmitsuba.machine.backend import dr, mi
from sarmitsuba.tracing.kernel import field
from sarmitsuba.tracing.kernel.intersector import query_ray
from sarmitsuba.tracing.kernel.scene_tables import MATERIAL_MASK
from sarmitsuba.tracing.kernel.table_rows import FaceRow, MaterialRow, SlabRow
from sarmitsuba.tracing.scatterers.slabs.slab_coefficients import SlabFactors, slab

if TYPE_CHECKING:
    from sarmitsuba.tracing.kernel.field import ComplexVector
    from sarmitsuba.tracing.kernel.scene_tables import TraceScene
    from sarmitsuba.tracing.kernel.state import Hit, Kernel, RayState
    from sarmitsuba.tracing.scatterers.slabs.slab_coefficients import SlabTables

# slabs that a path may cross before its last hit; the leg to the antenna may cross any number
MOST_SLABS = 6
# power relative to launch down to which both branches at a slab are traced
LEAST_POWER = 1e-12


def pass_leg(
    scene: TraceScene,
    wavenumber: mi.Float,
    clearance: mi.Float,
    start: mi.Vector3f,
    direction: mi.Vector3f,
    distance: mi.Float,
    active: mi.Bool,
    vectors: tuple[ComplexVector, ...],
) -> tuple[tuple[ComplexVector, ...], mi.Vector3f]:
    """Complex vectors at the start of a straight leg through slabs from those at its end, and the apparent shift, m.

    Seen through slabs the end of the leg appears shifted: farther by the delay, and sideways by refraction.

    Parameters
    ----------
    scene : with slabs
    wavenumber, clearance : rad/m; m, distance off a facet at which a leg that leaves it starts
    start, direction, distance : m, unit vector, m; of the leg
    active : lanes that have the leg
    vectors : of waves along the leg, or receiving vectors: transmission is a symmetric dyad
    """
    slabs = scene.slabs
    assert slabs is not None
    # no slab lies beyond the scene's bounds; order matters where the planes of incidence of two slabs differ
    length = dr.minimum(distance, _leaving(scene, clearance, start, direction))
    towards = -direction

    def some_left(
        left: mi.Float, active: mi.Bool, shift: mi.Vector3f, vectors: tuple[ComplexVector, ...]
    ) -> mi.Bool:
        return active

    def next_slab(
        left: mi.Float, active: mi.Bool, shift: mi.Vector3f, vectors: tuple[ComplexVector, ...]
    ) -> tuple[mi.Float, mi.Bool, mi.Vector3f, tuple[ComplexVector, ...]]:
        query = query_ray(start + direction * left, towards, left)
        met = slabs.transmitting.ray_intersect_preliminary(query, coherent=True, active=active)
        active = active & met.is_valid()
        face = dr.gather(mi.UInt32, slabs.transmitting_face, met.prim_index, active)
        first = face * 12
        n = mi.Vector3f(*(dr.gather(mi.Float64, scene.face_table, first + i, active) for i in (3, 7, 11)))
        behind = dr.dot(n, towards) > 0.0
        n = dr.select(behind, -n, n)
        material = FaceRow.of(scene.face_info, face, active).material_bits & MATERIAL_MASK
        properties = MaterialRow.of(scene.material_table, material, active)
        row = SlabRow.of(slabs.table, material, active)
        factors = slab_factors(properties, row, towards, n, behind)
        passed = _transmit_behind(vectors, towards, n, factors)
        vectors = tuple(
            tuple(dr.select(active, a, b) for a, b in zip(x, y, strict=True))
            for x, y in zip(passed, vectors, strict=True)
        )
        cosine = dr.maximum(-dr.dot(n, towards), 1e-7)
        step = met.t + _step_past(slabs, face, behind, active, clearance) / cosine
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
    r"""Apparent shift of the source of a wave along ``d`` by a slab, times the wavenumber, rad.

    .. math:: k \mathbf w = -k \Delta L\, \mathbf d - \frac{\partial \phi}{\partial \cos\theta}
              (\mathbf n + \cos\theta\, \mathbf d)

    with phase :math:`\phi` of T and the normal facing the wave: the path length from the shifted source to any point
    near the ray, and its derivatives by the position of the point or the antenna, are those through the slab.
    """
    return -d * factors.extra - (n - d * dr.dot(d, n)) * factors.aside


def slab_factors(
    properties: MaterialRow, row: SlabRow, d: mi.Vector3f, n: mi.Vector3f, behind: mi.Bool
) -> SlabFactors:
    """Reflection and transmission factors of a wave along ``d`` at a slab whose normal ``n`` faces it.

    Parameters
    ----------
    properties, row : rows of the material in `TraceScene.material_table` and in `SlabTables.table`
    behind : whether ``n`` is the reverse of the facet's normal: the wave then meets the coating first
    """
    cosine = dr.maximum(-dr.dot(d, n), 1e-7)
    return slab(cosine, properties.susceptibility, row.phase_thickness, row.sheet_admittance, behind)


@dataclass  # not frozen: part of the loop's state, which Dr.Jit writes to
class Waiting:
    """Stored branches of a lane's path at slabs, and the lane's number of hits on all branches.

    Parameters
    ----------
    memory : of the lane, one for each array of a ray's state
    count : stored branches
    hits : so far
    """

    memory: list[Any]
    count: mi.UInt32
    hits: mi.UInt32

    @staticmethod
    def none(ray: RayState) -> Waiting:
        """Empty memory for the branches of rays with this state."""
        memory = [dr.alloc_local(type(x), MOST_SLABS, value=dr.zeros(type(x))) for x in _arrays(ray)]
        # one number per lane from the start: with a single number all lanes would use the memory of the first
        count = dr.zeros(mi.UInt32, dr.width(ray.active))
        return Waiting(memory, count, mi.UInt32(0))


def branch_ray(
    kernel: Kernel, before: RayState, hit: Hit, mirrored: RayState, waiting: Waiting
) -> tuple[RayState, Waiting]:
    """Next ray of a lane: transmitted through the slab it hit, reflected, or a stored branch.

    Parameters
    ----------
    before : the incident ray, before the phase of foci is applied
    hit : on a slab or not
    mirrored : the reflected ray; not active after its last bounce
    waiting : branches stored before

    Notes
    -----
    Ignores transmission after ``MOST_SLABS`` slabs. A branch below ``LEAST_POWER`` is left out; where both are below,
    only the reflected one is traced: otherwise the number of paths in a room of slabs grows exponentially with the
    bounces. A tube is not cut at the edge of a slab: it is transmitted whole or not at all, as its central ray.
    """
    assert before.crossed is not None and hit.slab is not None
    slabs, clearance = _slabs(kernel), kernel.constants.clearance
    d, n = hit.direction, hit.normal
    factors = slab_factors(hit.properties, hit.slab, d, n, hit.behind)
    passed = _transmit_behind(before.fields, d, n, factors)
    transmitted = (
        hit.met & hit.slab.transmits & (before.crossed < MOST_SLABS) & (_power(passed) > LEAST_POWER)
    )
    step = mi.Vector3d(_shift(factors, d, n) / kernel.constants.wavenumber)
    along_ray = dr.dot(step, hit.direction64)
    aside = mi.Vector3f(step - hit.direction64 * along_ray)
    past = _step_past(slabs, hit.face, hit.behind, transmitted, clearance) / dr.maximum(-dr.dot(d, n), 1e-7)
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
    ray = _choose_ray(transmitted, gone, mirrored)
    # at the end of a path the branch stored last is taken up
    ended = ~ray.active & (count > 0)
    count = count - dr.select(ended, mi.UInt32(1), 0)
    stored = _rebuilt(ray, iter([memory.read(count, active=ended) for memory in waiting.memory]))
    ray = _choose_ray(ended, replace(stored, active=ended), ray)
    return ray, replace(waiting, count=count, hits=waiting.hits + dr.select(hit.active, mi.UInt32(1), 0))


def _slabs(kernel: Kernel) -> SlabTables:
    slabs = kernel.scene.slabs
    assert slabs is not None
    return slabs


def _transmit_behind(
    vectors: Sequence[ComplexVector], d: mi.Vector3f, n: mi.Vector3f, factors: SlabFactors
) -> tuple[ComplexVector, ...]:
    h = field.incidence_basis(d, n)
    return tuple(field.reflect_field(e, d, d, h, factors.t_te, factors.t_tm) for e in vectors)


def _power(vectors: Sequence[ComplexVector]) -> mi.Float:
    """Largest squared norm among complex vectors."""
    power = mi.Float(0.0)
    for re, im in vectors:
        power = dr.maximum(power, dr.squared_norm(re) + dr.squared_norm(im))
    return power


def _step_past(
    slabs: SlabTables, face: mi.UInt32, behind: mi.Bool, active: mi.Bool, clearance: mi.Float
) -> mi.Float:
    """How far along the normal a wave goes on from a face that it met: past the other face of a box, if it is one."""
    gap = dr.gather(mi.Float, slabs.gap, face, active)
    return dr.maximum(dr.select(behind, gap, -gap), 0.0) + clearance


def _leaving(scene: TraceScene, clearance: mi.Float, start: mi.Vector3f, d: mi.Vector3f) -> mi.Float:
    """Distance from a point of the scene along ``d`` to the scene's bounds, m."""
    low, high = (mi.Vector3f(*(dr.opaque(mi.Float, float(x)) for x in corner)) for corner in scene.bounds)
    inverse = 1.0 / dr.select(dr.abs(d) > 1e-12, d, 1e-12)
    far = dr.maximum((low - start) * inverse, (high - start) * inverse)
    return dr.maximum(dr.minimum(dr.minimum(far.x, far.y), far.z), 0.0) + clearance


def _arrays(value: Any) -> list[Any]:
    """Arrays of a ray's state without ``active`` (true for all stored branches) and the lane's count."""
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
    """State of the same structure with other arrays."""
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


def _choose_ray(condition: mi.Bool, a: RayState, b: RayState) -> RayState:
    """Ray ``a`` in the lanes where the condition holds, else ``b``."""
    pairs = zip(_arrays(a), _arrays(b), strict=True)
    chosen = _rebuilt(b, iter([dr.select(condition, x, y) for x, y in pairs]))
    ray: RayState = replace(
        chosen,
        active=dr.select(condition, a.active, b.active),
        contributions=b.contributions,
    )
    return ray
