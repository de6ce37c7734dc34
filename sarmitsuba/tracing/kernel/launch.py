"""Launch lattice: start points of the rays, a rotated square lattice in a plane across the line of sight."""

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from sarmitsuba.core.arrays import F32, F64, U32, unit_rows

# irrational rotation of the lattice (rad): no low-order lattice line is parallel to the window's axes
LATTICE_TURN = 0.5 * (5.0**0.5 - 1.0)

# number of rotations that are tried where edges of facets are known, and wanted angle between these edges and the
# lattice's lines (rad): tubes end at edges exactly down to half of it
TURNS, LEAST_ANGLE = 16, 1.0 / 30.0

Purpose = Literal["all", "coherent", "diffuse"]
# bounces that rays serve: those with rays of divided cells beside them serve the first, or the later ones
Serves = Literal["all", "first", "later"]


@dataclass(frozen=True)
class LatticeLevel:
    """Rays of one spacing within a lattice.

    Parameters
    ----------
    first : number of its first ray; its last one precedes the first of the next level
    spacing : m between neighbours
    needs : m, lower and upper bound of the ray spacing needed by the faces that these rays sample
    serves : bounces whose echoes these rays give
    weight : factor on the amplitudes of their echoes, such as -1 for rays whose echoes are taken off
    """

    first: int
    spacing: float
    needs: tuple[float, float]
    serves: Serves = "all"
    weight: float = 1.0


@dataclass(frozen=True, eq=False)
class LaunchGrid:
    """Lattice of rays, in coordinates (x, y) of the launch plane.

    Parameters
    ----------
    x, y : (n_rays,) float32, m, lattice points within the window, neighbours in memory near in space
    spacing : m between neighbouring rays, of the first level where there are several
    turn : rad, rotation of the lattice against the plane's axes
    half_x, half_y : m, half extents of the window that is covered at full weight
    taper : m, width of the taper beyond the half extents
    purpose : kind of return (coherent, diffuse) that these rays sample; the two need different spacings
    levels : sets of rays of different spacings, where some faces need denser rays; empty: one spacing
    frame : launch plane of this lattice; None: that of the launch window
    pulses : first pulse that these rays serve, and the one after the last; None: all
    n_own : number of the pulses whose rays ``x`` and ``y`` hold in turn, equally many each; 1: all have the same
    edges : rays on both sides of edges, for derivatives, see :mod:`sarmitsuba.tracing.derivatives.edge_tangents`;
        None: a lattice
    """

    x: F32
    y: F32
    spacing: float
    turn: float
    half_x: float
    half_y: float
    taper: float
    purpose: Purpose = "all"
    frame: "LaunchFrame | None" = None
    levels: tuple[LatticeLevel, ...] = ()
    pulses: tuple[int, int] | None = None
    n_own: int = 1
    edges: "EdgeSamples | None" = None

    def serves(self, pulse: int) -> bool:
        """Whether these rays are launched for a pulse."""
        return self.pulses is None or self.pulses[0] <= pulse < self.pulses[1]

    @property
    def n_rays(self) -> int:
        """Number of rays of a pulse."""
        return int(self.x.size) // self.n_own

    @property
    def every_level(self) -> tuple[LatticeLevel, ...]:
        """Levels of the lattice; a lattice of one spacing has a single level that serves every face."""
        return self.levels or (LatticeLevel(0, self.spacing, (0.0, np.inf)),)

    @property
    def level(self) -> U32:
        """(n_rays,) number of the level of each ray."""
        first = [level.first for level in self.every_level]
        return np.repeat(np.arange(len(first), dtype=np.uint32), np.diff([*first, self.n_rays]))


@dataclass(frozen=True, eq=False)
class EdgeSamples:
    """Rays on both sides of the edges of shapes.

    Parameters
    ----------
    weight : (n_rays n_own,) float32, length of the edge that the ray stands for over the square of the rays' spacing,
        1/m; negative on the outer side
    normal : (n_rays n_own, 2) float64, unit normals of the edges in the launch plane, outwards
    speeds : (n_displacements, n_rays n_own) float32, of the edges along their normals in the launch plane, m per unit
        of each displacement, or of each way of ``shapes``
    faces : (n_rays n_own, 2) uint32, facets that meet in the edge
    leg : (n_rays n_own,) uint32, of the path, from 1, on which the ray passes the edge
    shapes : (n_rays n_own, n) uint32, numbers of the shapes that move the edge; None where displacements are the same
        for all rays
    """

    weight: F32
    normal: F64
    speeds: F32
    faces: U32
    leg: U32
    shapes: U32 | None = None


@dataclass(frozen=True, eq=False)
class LaunchFrame:
    """Launch plane through ``center`` across the line of sight, for each pulse or one for all.

    Parameters
    ----------
    center : (n, 3) float64, m, scene frame
    axis_x, axis_y : (n, 3) float64 unit vectors of the plane
    """

    center: F64
    axis_x: F64
    axis_y: F64


def frame_towards(antenna: F64, center: F64, along: F64) -> LaunchFrame:
    """Launch planes through ``center`` across the lines of sight from ``antenna``.

    Parameters
    ----------
    antenna : (n, 3) float64, m; center : (3,); along : (3,) direction whose projection is the x axis
    """
    los = center - antenna
    los = unit_rows(los)
    x = along - los * (los @ along)[:, None]
    norm = np.linalg.norm(x, axis=1, keepdims=True)
    if not (norm > 1e-9).all():
        spare = np.cross(los, np.roll(np.eye(3)[np.argmin(np.abs(los), axis=1)], 1, axis=1))
        x = np.where(norm > 1e-9, x, spare)
    x = unit_rows(x)
    return LaunchFrame(np.broadcast_to(center, antenna.shape).copy(), x, np.cross(x, los))


def cross(a: F64, b: F64) -> F64:
    """Cross product of two vectors (3,), ten times as fast as NumPy's."""
    return np.array(
        [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]], dtype=np.float64
    )


def project(points: F64, antenna: F64, frame: LaunchFrame) -> F64:
    """(..., 2) coordinates in the first launch plane of scene points (..., 3) seen from the antenna, m."""
    c, ux, uy = frame.center[0], frame.axis_x[0], frame.axis_y[0]
    w = cross(ux, uy)
    # columns: products of many rows of three with a vector are slow
    ray = [points[..., k] - antenna[k] for k in range(3)]
    t = ((c - antenna) @ w) / (ray[0] * w[0] + ray[1] * w[1] + ray[2] * w[2])
    hit = [antenna[k] + ray[k] * t - c[k] for k in range(3)]
    return np.stack([hit[0] * u[0] + hit[1] * u[1] + hit[2] * u[2] for u in (ux, uy)], axis=-1)


def window_of(points: F64, antenna: F64, frame: LaunchFrame) -> tuple[F64, F64]:
    """Lower and upper (x, y) of scene points seen from the antenna and projected onto the first launch plane."""
    xy = project(points, antenna, frame)
    return np.asarray(xy.min(axis=0)), np.asarray(xy.max(axis=0))


def _spread_bits(v: U32) -> U32:
    for shift, mask in ((8, 0x00FF00FF), (4, 0x0F0F0F0F), (2, 0x33333333), (1, 0x55555555)):
        v = np.asarray((v | (v << np.uint32(shift))) & np.uint32(mask), dtype=np.uint32)
    return v


def morton(x: F64, y: F64, half: float) -> U32:
    """Keys that sort points of the square ``|x|, |y| <= half`` so that neighbours in memory are near in space."""
    cell = 2.0 * half / 65535.0
    return np.asarray(
        _spread_bits(((x + half) / cell).astype(np.uint32))
        | (_spread_bits(((y + half) / cell).astype(np.uint32)) << np.uint32(1))
    )


def lattice(
    half_x: float,
    half_y: float,
    spacing: float,
    *,
    taper: float = 0.0,
    seed: int = 0,
    realisation: int = 0,
    purpose: Purpose = "all",
    edges: F64 | None = None,
) -> LaunchGrid:
    """Cover the rectangle |x| <= half_x + taper, |y| <= half_y + taper with a turned, shifted square lattice.

    Tubes of the lattice tile the plane, so the phase integrals over a flat facet sum to an integral over its outline.
    The rotation keeps the outline from being parallel to the lattice, which would give false lobes along the normals
    of the facet's edges. A window too small to contain a lattice point has one ray, in its middle.

    Parameters
    ----------
    half_x, half_y, spacing, taper : m
    seed : of the random shift of the lattice and of a part of its rotation
    realisation : number of the independent lattice of this seed (ray subsets, passes)
    purpose : stored in the lattice
    edges : (n, 2) m, edges of facets projected onto the launch plane, to which no line of the lattice should be
        parallel; None: no such condition
    """
    rng = np.random.default_rng([seed & 0x7FFFFFFF, realisation, 0x5A12])
    shift = rng.random(2) * spacing
    turns = LATTICE_TURN + 0.25 * np.pi * rng.random(TURNS) * ((np.arange(TURNS) + realisation + seed) > 0)
    # keep away from the axes and diagonals of the window
    turns = 0.15 + (turns % (0.25 * np.pi - 0.3))
    turn = float(turns[0] if edges is None else turns[np.argmin(_sum_along_edges(turns, edges))])
    hx, hy = half_x + taper, half_y + taper
    radius = np.hypot(hx, hy)
    n = int(np.ceil(radius / spacing)) + 1
    c, s = np.cos(turn), np.sin(turn)
    xs, ys, keys = [], [], []
    rows = np.arange(-n, n + 1)
    step = max(1, 4_000_000 // rows.size)  # bounds the temporary arrays of one slab
    for start in range(0, rows.size, step):
        j = rows[start : start + step][:, None].astype(np.float64)
        i = rows[None, :].astype(np.float64)
        x = (i * c - j * s) * spacing + shift[0]
        y = (i * s + j * c) * spacing + shift[1]
        keep = (np.abs(x) <= hx) & (np.abs(y) <= hy)
        x, y = x[keep], y[keep]
        xs.append(x.astype(np.float32))
        ys.append(y.astype(np.float32))
        keys.append(morton(x, y, radius))
    if not any(part.size for part in xs):
        xs, ys, keys = [np.zeros(1, np.float32)], [np.zeros(1, np.float32)], [np.zeros(1, np.uint32)]
    order = np.argsort(
        np.concatenate(keys), kind="stable"
    )  # Morton order: neighbours share cache lines of the BVH
    return LaunchGrid(
        np.concatenate(xs)[order], np.concatenate(ys)[order], spacing, turn, half_x, half_y, taper, purpose
    )


def _sum_along_edges(turns: F64, edges: F64) -> F64:
    """Sum of the squared lengths of those edges (n, 2) that are nearly parallel to a lattice, for each rotation."""
    from_line = (np.arctan2(edges[:, 1], edges[:, 0]) - turns[:, None]) % (0.5 * np.pi)
    from_line = np.minimum(from_line, 0.5 * np.pi - from_line)
    return np.asarray(np.maximum(1.0 - from_line / LEAST_ANGLE, 0.0) @ np.square(edges).sum(axis=1))


@dataclass(frozen=True, eq=False)
class PulseBatch:
    """Antenna state of the pulses of one launch; lane = pulse * n_rays + ray.

    Parameters
    ----------
    position, velocity : (n, 3) float64, m and m/s, scene frame
    frame : launch planes, one for all pulses or one each
    boresight, azimuth_axis, elevation_axis : (n, 3) float64 or None when the antenna is isotropic
    azimuth_later : the azimuth pattern is applied in the synthesis of a block, at the mean direction of both legs
    receiver : state of a separate receiving antenna; None: one antenna transmits and receives
    time : (n,) float64, s, where the kernel depends on it (motion, waves); None: everything is as at time zero
    """

    position: F64
    velocity: F64
    frame: LaunchFrame
    boresight: F64 | None = None
    azimuth_axis: F64 | None = None
    elevation_axis: F64 | None = None
    azimuth_later: bool = False
    receiver: "PulseBatch | None" = None
    time: F64 | None = None

    @property
    def with_azimuth_later(self) -> "PulseBatch":
        """The same batch, with the azimuth pattern to be applied in the synthesis of the block."""
        receiver = None if self.receiver is None else self.receiver.with_azimuth_later
        return replace(self, azimuth_later=True, receiver=receiver)

    @property
    def n_pulses(self) -> int:
        """Number of pulses in the launch."""
        return int(self.position.shape[0])
