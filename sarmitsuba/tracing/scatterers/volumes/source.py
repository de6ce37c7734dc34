"""Volumes (vegetation) in the kernel: extinction of waves that pass through, and their volume scatterers."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, TypeAlias

import numpy as np
from numpy.typing import NDArray

from sarmitsuba.core.arrays import F64, U32
from sarmitsuba.machine.backend import dr, mi
from sarmitsuba.scene.materials.vegetation.canopy import NODES
from sarmitsuba.tracing.kernel import field
from sarmitsuba.tracing.kernel.device_arrays import device_array, vector_rows
from sarmitsuba.tracing.kernel.intersector import intersector, query_ray
from sarmitsuba.tracing.kernel.leg import Leg
from sarmitsuba.tracing.kernel.passage import Passage
from sarmitsuba.tracing.kernel.scattering_matrix import Drawn, one_term
from sarmitsuba.tracing.kernel.source import PointSource, Scatterers, Source
from sarmitsuba.tracing.kernel.speckle import gaussian, mix
from sarmitsuba.tracing.kernel.temporal import Age
from sarmitsuba.tracing.scatterers.sources import SOURCES, Expected, Site, SourceKind, most_bounces
from sarmitsuba.tracing.scatterers.volumes.kind import Volume, volumes_of

if TYPE_CHECKING:
    from sarmitsuba.scene.materials.vegetation.canopy import VolumeMedium
    from sarmitsuba.scene.scene import Scene
    from sarmitsuba.tracing.kernel.state import Kernel

Pair: TypeAlias = "tuple[mi.Float, mi.Float]"
# both weights of a volume, from its number, the number of its medium, and the active lanes
Weigh: TypeAlias = "Callable[[mi.UInt32, mi.UInt32, mi.Bool], Pair]"

# seconds of a reference core: for laying out a cell of the lattice, and for tracing a scatterer
CELL_LAID, SCATTERER_TRACED = 1e-6, 8e-6
# bytes of a cell while it is laid out, and of a scatterer that is kept
CELL_BYTES, SCATTERER_BYTES = 150, 100
# scatterers per resolution cell on a mean path through a volume, and the least number in a volume
PER_CELL, LEAST = 10.0, 8.0
# number of different shrinkages (steps of a millimetre at most in scenes up to a kilometre) that separate neighbours
RANKS = 8
# tries, slightly displaced, for a line whose entries into and exits from volumes do not match
_TRIES = 3
# values of one row of the table of scattering amplitudes, a power of two for the gathers
_ROW = 16


@dataclass  # not frozen: a loop's state, which Dr.Jit writes to
class _Crossing:
    """State of the loop over the crossings of a line with the surfaces of volumes.

    Parameters
    ----------
    going : lanes that continue
    t : m, from the line's origin to the start of the search for the next crossing
    aside : m, displacement from the line
    first, second : sums so far
    left : hashes of volumes entered minus those of volumes left; 0 where all entries have an exit
    tries : number so far
    """

    going: mi.Bool
    t: mi.Float
    aside: mi.Vector3f
    first: mi.Float
    second: mi.Float
    left: mi.UInt32
    tries: mi.UInt32


@dataclass(frozen=True, eq=False)
class VolumeSurfaces:
    """Ray-tracing structure of the surfaces of all volumes.

    Parameters
    ----------
    mi_scene : ``mi.Scene`` holding one mesh
    face_normal : (4 n_faces,) float32, outward normal; the fourth number is not used
    face_volume : (2 n_faces,) uint32, number of the volume and of its medium
    bounds : (2, 3) float64, m
    """

    mi_scene: mi.Scene
    face_normal: mi.Float
    face_volume: mi.UInt32
    bounds: F64

    @staticmethod
    def of(volumes: Sequence[Volume], medium: Sequence[int]) -> VolumeSurfaces:
        """Surfaces of volumes, each with the number of its medium."""
        step = _step(np.concatenate([volume.bounds for volume in volumes]))
        apart = [3.0 * step * (1 + i % RANKS) for i in range(len(volumes))]
        corners = np.concatenate(
            [_shrunk(volume, by)[volume.faces] for volume, by in zip(volumes, apart, strict=True)]
        ).astype(np.float32)
        volume = np.repeat(np.arange(len(volumes), dtype=np.uint32), [len(v.faces) for v in volumes])
        a, b, c = (corners[:, i].astype(np.float64) for i in range(3))
        normal = np.zeros((len(corners), 4), dtype=np.float32)
        normal[:, :3] = np.cross(b - a, c - a)
        normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-30)
        pair = np.stack([volume, np.asarray(medium, dtype=np.uint32)[volume]], axis=1)
        return VolumeSurfaces(
            intersector(corners),
            device_array(mi.Float, normal),
            device_array(mi.UInt32, pair),
            np.stack([corners.min(axis=(0, 1)), corners.max(axis=(0, 1))]).astype(np.float64),
        )

    def within(
        self, origin: mi.Vector3f, direction: mi.Vector3f, distance: mi.Float, active: mi.Bool, weigh: Weigh
    ) -> Pair:
        r"""Two weighted path lengths of a straight leg within volumes: sums over volumes of weight times length.

        .. math:: \sum_{\text{leaving}} w t - \sum_{\text{entering}} w t, \quad 0 \le t \le \text{distance}

        over all crossings of the line, from before the first volume to behind the last, with t clipped to the leg:
        the order of crossings does not matter, volumes may overlap, and either end may lie within a volume.
        Entries and exits are matched volume by volume: a line on which one is missed by rounding is tried again
        slightly displaced, and counts as outside all volumes if no try matches.

        Parameters
        ----------
        origin, direction, distance, active : of the leg, as for a passage
        weigh : gives both weights of a volume, from its number and that of its medium
        """
        f32, u32 = mi.Float, mi.UInt32
        low, high = (mi.Vector3f(*(dr.opaque(f32, float(x)) for x in corner)) for corner in self.bounds)
        step = dr.opaque(f32, _step(self.bounds))
        inverse = dr.rcp(dr.select(dr.abs(direction) > 1e-9, direction, 1e-9))
        a, b = (low - origin) * inverse, (high - origin) * inverse
        near, far = dr.max(dr.minimum(a, b)), dr.min(dr.maximum(a, b))
        before = near - 0.01 * (far - near) - 4.0 * step
        none, side = dr.zeros(f32), mi.coordinate_system(direction)[0] * (3.0 * step)

        def going(state: _Crossing) -> mi.Bool:
            return state.going

        def cross(state: _Crossing) -> tuple[_Crossing]:
            found = self.mi_scene.ray_intersect_preliminary(
                query_ray(origin + state.aside + direction * state.t, direction),
                coherent=False,
                active=state.going,
            )
            met = state.going & found.is_valid()
            there = state.t + found.t
            info = dr.gather(mi.Vector2u, self.face_volume, found.prim_index, met)
            row = dr.gather(mi.Vector4f, self.face_normal, found.prim_index, met)
            normal = mi.Vector3f(row.x, row.y, row.z)
            enters = dr.dot(normal, direction) < 0.0
            reached = dr.clip(there, 0.0, distance)
            signed = dr.select(met, dr.select(enters, -reached, reached), none)
            first, second = weigh(info.x, info.y, met)
            key = mix(info.x + 1)
            left = state.left + dr.select(met, dr.select(enters, key, ~key + 1), u32(0))
            # at the end of the line: done if entries and exits match, else another try
            again = state.going & ~met & (left != 0)
            tries = dr.select(again, state.tries + 1, state.tries)
            # off the surface, also where the line is nearly parallel to it
            off = dr.select(enters, -normal, normal) * step
            return (
                _Crossing(
                    going=met | (again & (tries < _TRIES)),
                    t=dr.select(again, before, dr.select(met, there + step, state.t)),
                    aside=dr.select(met, off, side * f32(tries)),
                    first=dr.select(again, none, dr.fma(signed, first, state.first)),
                    second=dr.select(again, none, dr.fma(signed, second, state.second)),
                    left=dr.select(again, u32(0), left),
                    tries=tries,
                ),
            )

        there = active & (near < far) & (far > 0.0) & (near < distance)
        start = _Crossing(there, f32(before), mi.Vector3f(0.0), f32(none), f32(none), u32(0), u32(0))
        found: tuple[_Crossing] = dr.while_loop(
            (start,), going, cross, labels=("crossing",), label="crossings", mode="symbolic"
        )
        return found[0].first, found[0].second


@dataclass(frozen=True, eq=False)
class VolumePassage:
    r"""Extinction by volumes: the field of H is multiplied by :math:`e^{-\tau_H / 2}`, likewise of V.

    H is horizontal and transverse to the leg; V is transverse to both. With the path length s in every volume and its
    extinction at the angle of the leg, :math:`\tau = \sum \kappa s`.

    Parameters
    ----------
    surfaces : of all volumes
    extinction : (2 NODES n_media,) float32, 1/m, H and V over the cosine to the vertical

    Notes
    -----
    Ignores the delay in volumes and forward scattering into the leg.
    """

    surfaces: VolumeSurfaces
    extinction: mi.Float

    def through(
        self,
        origin: mi.Vector3f,
        direction: mi.Vector3f,
        distance: mi.Float,
        active: mi.Bool,
        fields: tuple[field.ComplexVector, ...],
    ) -> tuple[field.ComplexVector, ...]:
        """See :class:`sarmitsuba.tracing.kernel.passage.Passage`."""
        node, share = _node(dr.abs(direction.z))

        def extinction(volume: mi.UInt32, medium: mi.UInt32, active: mi.Bool) -> Pair:
            row = medium * NODES + node
            low, high = (dr.gather(mi.Vector2f, self.extinction, row + i, active) for i in (0, 1))
            kappa = dr.lerp(low, high, share)
            return kappa.x, kappa.y

        depth_h, depth_v = self.surfaces.within(origin, direction, distance, active, extinction)
        kept_h, kept_v = dr.exp(-0.5 * depth_h), dr.exp(-0.5 * depth_v)
        h, v = field.polarisation_basis(direction, _up())
        return tuple(
            field.add(
                field.scale(field.dot(e, h) * kept_h, h),
                field.scale(field.dot(e, v) * kept_v, v),
            )
            for e in fields
        )


@dataclass(frozen=True, eq=False)
class VolumeScatterers(Scatterers):
    r"""Volume scatterers, fixed to the scene and uniform in each volume, with the mean power of their share of it.

    Each cell of a cubic lattice, rotated against the axes, has one scatterer at a random position, kept if it lies
    inside. In a volume V with n scatterers each has :math:`\sqrt{V / n}` times a scattering matrix of independent
    circular Gaussians, hashed from cell and volume, with the medium's polarimetric covariance at the angle of the leg:
    the same in every pulse, look, band and pass as long as the spacing of the scatterers is the same.

    Between two directions the matrix refers to the H and V of each, at the mean of both cosines to the vertical.

    Parameters
    ----------
    n : number of scatterers
    place : (3 n,) float64, m, scene frame
    key : (n,) uint32, hash
    weight : (n,) float32, square root of the volume that each represents, m^(3/2)
    medium : (n,) uint32
    table : (16 NODES n_media,) float32, for backscatter and for the path over the ground, see `Covariance.factors`
    change : (2 n_media,) float32: coherence between passes that never decays, and time constant (days) of the rest;
        None where no medium changes
    owner : (n,) number of the volume of each

    Notes
    -----
    The covariances are those of backscatter and of the path over horizontal ground; for bistatic angles and sloping
    ground they are taken at the mean of both angles.
    """

    n: int
    place: mi.Float64
    key: mi.UInt32
    weight: mi.Float
    medium: mi.UInt32
    table: mi.Float
    change: mi.Float | None
    owner: NDArray[np.integer]
    mechanism: ClassVar[str] = "volume"

    def point(self, index: mi.UInt32) -> mi.Vector3d:
        """See the class above."""
        return dr.gather(mi.Vector3d, self.place, index)

    def amplitude(
        self,
        kernel: Kernel,
        index: mi.UInt32,
        incident: Leg,
        scattered: Leg,
        e: field.ComplexVector,
        q: field.ComplexVector,
    ) -> mi.Complex2f:
        """See the class above."""
        key = dr.gather(mi.UInt32, self.key, index)
        node, share = _node(0.5 * (dr.abs(incident.to_antenna.z) + dr.abs(scattered.to_antenna.z)))
        row = (dr.gather(mi.UInt32, self.medium, index) * NODES + node) * 4
        first = 2 if incident.over_ground != scattered.over_ground else 0
        four = [dr.gather(mi.Vector4f, self.table, row + (first + i)) for i in (0, 1, 4, 5)]
        size, mixed = dr.lerp(four[0], four[2], share), dr.lerp(four[1], four[3], share)
        age = Age.of(kernel, self.change, dr.gather(mi.UInt32, self.medium, index))
        drawn: Drawn = gaussian if age is None else age.gaussian
        if kernel.constants.term is not None:
            drawn = one_term(kernel.constants.term)
        g1, g2, g3 = (drawn(key, i) for i in range(3))
        hh = g1 * size.x
        vv = g1 * mi.Complex2f(mixed.x, mixed.y) + g2 * size.y
        hv = g3 * size.z
        in_h, in_v = field.polarisation_basis(-incident.to_antenna, _up())
        out_h, out_v = field.polarisation_basis(-scattered.to_antenna, _up())
        e_h, e_v, q_h, q_v = (field.dot(x, y) for x, y in ((e, in_h), (e, in_v), (q, out_h), (q, out_v)))
        total = q_h * e_h * hh + q_v * e_v * vv + (q_h * e_v + q_v * e_h) * hv
        return total * dr.gather(mi.Float, self.weight, index)


def _step(places: F64) -> float:
    """Distance behind a crossing at which the search continues, m, for the largest coordinate in ``places``."""
    return 1e-5 + 16.0 * 2.0**-24 * float(np.abs(places).max())


def _shrunk(volume: Volume, by: float) -> F64:
    """Vertices (n_v, 3), m, of a volume shrunk so that its least half width is smaller by ``by``, m.

    Otherwise adjacent or coincident volumes would have coincident surfaces, which rays cannot separate.
    """
    middle = volume.bounds.mean(axis=0)
    half = 0.5 * float(np.ptp(volume.bounds, axis=0).min())
    return np.asarray(middle + (volume.vertices - middle) * (1.0 - min(by / half, 0.05)))


def _node(cosine: mi.Float) -> tuple[mi.UInt32, mi.Float]:
    """Lower node of the tables at a cosine, and the share of the upper one."""
    place = dr.clip(cosine, 0.0, 1.0) * (NODES - 1.0)
    node = mi.UInt32(dr.minimum(place, NODES - 2.0))
    return node, place - mi.Float(node)


def _up() -> mi.Vector3f:
    """Vertical unit vector, the reference of the orientation of plant elements."""
    return mi.Vector3f(0.0, 0.0, 1.0)


def _number_media(volumes: Sequence[Volume]) -> tuple[list[VolumeMedium], list[int]]:
    """Distinct media of volumes, and the number of the medium of each volume."""
    media = {id(volume.medium): volume.medium for volume in volumes}
    numbers = {key: i for i, key in enumerate(media)}
    return list(media.values()), [numbers[id(volume.medium)] for volume in volumes]


def volume_passage(volumes: Sequence[Volume]) -> VolumePassage:
    """Extinction by volumes, as a passage of the kernel."""
    media, number = _number_media(volumes)
    table = np.stack([medium.extinction for medium in media]).astype(np.float32)
    return VolumePassage(VolumeSurfaces.of(volumes, number), device_array(mi.Float, table))


def volume_scatterers(
    volumes: Sequence[Volume], cell_area: float, seed: int, shares: Callable[[F64], F64] | None = None
) -> VolumeScatterers:
    """Volume scatterers of volumes.

    Parameters
    ----------
    volumes : one at least
    cell_area : m^2, resolution cell perpendicular to the elevation direction; it holds ``PER_CELL`` scatterers
    seed : of their positions and amplitudes
    shares : function from positions (n, 3) to factors (n,) on the amplitude at the border of a cropped image; None:
        one everywhere
    """
    media, number = _number_media(volumes)
    spacing = [scatterer_spacing(volume, cell_area) for volume in volumes]
    cells = [_cells(volume, step, seed) for volume, step in zip(volumes, spacing, strict=True)]
    volume = np.repeat(np.arange(len(volumes), dtype=np.uint32), [len(key) for _, key in cells])
    place, key = np.concatenate([p for p, _ in cells]), np.concatenate([k for _, k in cells])
    inside = _inside(VolumeSurfaces.of(volumes, number), place, volume, 0.05 * min(spacing))
    place, key, volume = place[inside], key[inside], volume[inside]
    content = np.array([volume.content for volume in volumes])
    weight = np.sqrt(content / np.maximum(np.bincount(volume, minlength=len(volumes)), 1))[volume]
    if shares is not None:
        share = shares(place)
        shown = share > 1e-6
        place, key, volume, weight = place[shown], key[shown], volume[shown], (weight * share)[shown]
    rows = np.zeros((len(media), NODES, _ROW), dtype=np.float32)
    for row, medium in zip(rows, media, strict=True):
        for start, returned in ((0, medium.back), (_ROW // 2, medium.over_ground)):
            first, second, mixed, cross = returned.factors
            columns = [first, second, cross, 0.0 * first, mixed.real, mixed.imag]
            row[:, start : start + 6] = np.stack(columns, axis=1)
    return VolumeScatterers(
        n=len(place),
        place=vector_rows(place),
        key=device_array(mi.UInt32, key),
        weight=device_array(mi.Float, weight.astype(np.float32)),
        medium=device_array(mi.UInt32, np.asarray(number, dtype=np.uint32)[volume]),
        table=device_array(mi.Float, rows),
        change=_change(media),
        owner=volume,
    )


def _change(media: Sequence[VolumeMedium]) -> mi.Float | None:
    """Persistent coherence and time constant of every medium; None where nothing changes."""
    if all(medium.temporal_coherence == 1.0 for medium in media):
        return None
    rows = [(medium.temporal_coherence, medium.decorrelation_days) for medium in media]
    return device_array(mi.Float, np.asarray(rows, dtype=np.float32))


def scatterer_spacing(volume: Volume, cell_area: float) -> float:
    """Spacing of the scatterers of a volume, m: as given, or a power of the root of two.

    Steps of the root of two give radars of similar resolution the same scatterers; small volumes have several.
    """
    if volume.spacing > 0.0:
        return volume.spacing
    share = min(cell_area * volume.mean_chord / PER_CELL, volume.content / LEAST)
    return float(2.0 ** (0.5 * np.floor(2.0 * np.log2(share) / 3.0)))


def _cells(volume: Volume, step: float, seed: int) -> tuple[F64, U32]:
    """Random position (n, 3), m, in every cell of the lattice about a volume, and its hash (n,)."""
    low, high = volume.bounds
    first, last = np.floor(low / step).astype(np.int64), np.floor(high / step).astype(np.int64)
    number = np.stack(
        np.meshgrid(*(np.arange(a, b + 1) for a, b in zip(first, last, strict=True)), indexing="ij"), axis=-1
    ).reshape(-1, 3)
    # hash of the volume: where two overlap each has its own scatterers
    key = mix(np.full(len(number), 0x9E3779B1, dtype=np.uint32))
    for value in (seed, *number.T, *np.round(1e3 * low).astype(np.int64), round(1e3 * step)):
        key = mix(key ^ (np.asarray(value) & 0xFFFFFFFF).astype(np.uint32))
    drawn = np.stack([mix(key + np.uint32(i + 1)) for i in range(3)], axis=1) / 2.0**32
    place = (number + drawn) * step
    within = ((place >= low) & (place <= high)).all(axis=1)
    return place[within], key[within]


def _inside(surfaces: VolumeSurfaces, place: F64, volume: U32, short: float) -> NDArray[np.bool_]:
    """Whether positions (n, 3) lie within their volume, (n,): tested by a short leg (m) from each."""
    own, none = device_array(mi.UInt32, volume), dr.zeros(mi.Float)

    def is_own(volume: mi.UInt32, medium: mi.UInt32, active: mi.Bool) -> Pair:
        return dr.select(volume == own, mi.Float(1.0), none), none

    start = mi.Vector3f(dr.gather(mi.Vector3d, vector_rows(place), dr.arange(mi.UInt32, len(place))))
    length, _ = surfaces.within(start, _up(), dr.opaque(mi.Float, short), mi.Bool(True), is_own)
    return np.asarray(length.numpy() > 0.5 * short)


class VolumeCells(SourceKind):
    """Volumes as scatterers in cells of a lattice."""

    name, rank = "volumes", 20

    def make_source(self, site: Site) -> Source | None:
        """See :class:`SourceKind`."""
        scene, volumes = site.scene, volumes_of(site.scene.scatterers)
        if not volumes:
            return None
        scatterers = volume_scatterers(volumes, site.cell_area, scene.settings.seed, site.shares)
        return PointSource(scatterers, most_bounces(scene)) if scatterers.n else None

    def estimate_cost(self, site: Site, sub_bands: int) -> Expected | None:
        """Cost from the number of cells in the bounding boxes, and of scatterers inside the volumes."""
        volumes, area = volumes_of(site.scene.scatterers), site.cell_area
        if not volumes:
            return None
        steps = [scatterer_spacing(volume, area) for volume in volumes]
        boxes = [
            float(np.prod(np.ptp(volume.bounds, axis=0) / step + 1.0))
            for volume, step in zip(volumes, steps, strict=True)
        ]
        kept = sum(volume.content / step**3 for volume, step in zip(volumes, steps, strict=True))
        making = sum(boxes) * CELL_LAID
        return Expected(kept, making, SCATTERER_TRACED, max(boxes) * CELL_BYTES + kept * SCATTERER_BYTES)

    def passage(self, scene: Scene) -> Passage | None:
        """See :class:`SourceKind`: extinction."""
        volumes = volumes_of(scene.scatterers)
        return volume_passage(volumes) if volumes else None


SOURCES.register(VolumeCells())
