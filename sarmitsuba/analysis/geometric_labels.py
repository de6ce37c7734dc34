"""Layover, shadow, incidence angle and positions of the surfaces that fall into the pixels of an image.

Triangles are cut into pixels: every part gives the point of the surface that its pixel's centre shows.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, fields, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from sarmitsuba.analysis.label_sight import SightLines
from sarmitsuba.core.arrays import F64, I64
from sarmitsuba.core.errors import DataError
from sarmitsuba.radar.radar import Radar
from sarmitsuba.scene.geometry import Geometry
from sarmitsuba.scene.ground import continue_ground
from sarmitsuba.scene.motion import STILL, Motion
from sarmitsuba.scene.scene import Scene
from sarmitsuba.signal.focusing.placement import ImagePlacement
from sarmitsuba.signal.image import ImageGrid
from sarmitsuba.signal.pixel_labels import LabelLayer

# largest error, in pixels, of a linear map from the image to a triangle
BENT = 0.02
# length of an edge, in pixels, from which it is divided
_SHORT = 0.25
# length of an edge, over its distance from the antenna, below which a triangle without a place in the image is dropped
_SMALL = 1e-3
# triangles divided at once, and spans of rows filled at once; bound the temporary arrays
_CHUNK, _SPANS = 200_000, 1_000_000
# corners of the parts of a triangle by the number of its divided edges, the undivided ones last: corners 0 to 2 and
# middles 3 to 5 of the edges that begin there
_PARTS = {
    1: ((0, 3, 2), (3, 1, 2)),
    2: ((3, 1, 4), (0, 3, 4), (0, 4, 2)),
    3: ((0, 3, 5), (3, 1, 4), (5, 4, 2), (3, 4, 5)),
}

# row and column, in pixels, of points (n, 3), m; NaN outside the radar's side
Placed = Callable[[F64], F64]
# whether spheres about points (n, 3) of radii (n,), m, may hold something of the image
Reached = Callable[[F64, F64], NDArray[np.bool_]]


@dataclass(frozen=True, eq=False)
class Fragments:
    """Points of surfaces at the centres of pixels.

    Parameters
    ----------
    pixel : (n,) number of the pixel, row by row
    face : (n,) row of the triangle
    point : (n, 3) float64, m
    area : (n,) float64, m^2 of surface that falls into a pixel there
    """

    pixel: I64
    face: I64
    point: F64
    area: F64

    def __getitem__(self, pick: NDArray[np.generic]) -> "Fragments":
        """Some of them."""
        return Fragments(*(getattr(self, f.name)[pick] for f in fields(self)))

    @staticmethod
    def joined(parts: list["Fragments"]) -> "Fragments":
        """Concatenation of several sets."""
        return Fragments(*(np.concatenate([getattr(p, f.name) for p in parts]) for f in fields(Fragments)))


def fragments(
    corners: F64, placed: Placed, shape: tuple[int, int], antenna: F64, reached: Reached | None = None
) -> Fragments:
    """Every point of triangles whose place in the image is the centre of a pixel.

    A triangle is divided at the middles of its edges until the image shows each edge straight to ``BENT`` of a pixel;
    neighbours divide a common edge alike, so that no gap opens between them. An edge belongs to one of its two
    triangles: a connected surface that the image does not fold has one point in each pixel.

    Parameters
    ----------
    corners : (n, 3, 3) float64, m
    placed : row and column (n, 2) of points (n, 3)
    shape : rows and columns of the image
    antenna : (3,) m; sizes of triangles without a place are judged from there
    reached : spheres that may hold something of the image; None: all
    """
    found = [_empty()]
    for start in range(0, len(corners), _CHUNK):
        rows = np.arange(start, min(start + _CHUNK, len(corners)))
        for triangle, place, face in _straight(corners[rows], rows, placed, shape, antenna, reached):
            found += list(_fill_triangles(triangle, place, face, shape))
    return Fragments.joined(found)


def _empty() -> Fragments:
    none = np.zeros(0, dtype=np.int64)
    return Fragments(none, none, np.zeros((0, 3)), np.zeros(0))


def _straight(
    corners: F64, face: I64, placed: Placed, shape: tuple[int, int], antenna: F64, reached: Reached | None
) -> Iterator[tuple[F64, F64, I64]]:
    """Parts of triangles that lie in the image and are straight there: corners, places (n, 3, 2) and rows of faces."""
    stack = [(corners, placed(corners.reshape(-1, 3)).reshape(-1, 3, 2), face)]
    while stack:
        corners, place, face = stack.pop()
        if len(face) > _CHUNK:
            half = len(face) // 2
            stack += [(corners[p], place[p], face[p]) for p in (slice(half), slice(half, None))]
            continue
        middle = 0.5 * (corners + np.roll(corners, -1, axis=1))
        between = placed(middle.reshape(-1, 3)).reshape(-1, 3, 2)
        bend = np.abs(between - 0.5 * (place + np.roll(place, -1, axis=1))).max(axis=2)
        every = np.concatenate([place, between], axis=1)
        known = np.isfinite(every).all(axis=(1, 2))
        with np.errstate(invalid="ignore"):
            spare = 2.0 * bend.max(axis=1)[:, None] + 1.0
            inside = ((every.max(axis=1) > -spare) & (every.min(axis=1) < np.array(shape) + spare)).all(
                axis=1
            )
        edge = np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=2)
        large = edge.max(axis=1) > _SMALL * np.linalg.norm(corners[:, 0] - antenna, axis=1)
        if reached is not None:
            middles = corners.mean(axis=1)
            large &= reached(middles, np.linalg.norm(corners - middles[:, None], axis=2).max(axis=1))
        kept = np.where(known, inside, np.isfinite(every).any(axis=(1, 2)) & large)
        corners, place, middle, between = (x[kept] for x in (corners, place, middle, between))
        face, bend, known = face[kept], bend[kept], known[kept]
        # decided by the edge alone, so alike on both sides of it; NaN: an end has no place
        steps = np.abs(np.roll(place, -1, axis=1) - place).max(axis=2)
        divided = ~(bend <= BENT) & ~(steps < _SHORT)
        whole = ~divided.any(axis=1)
        if whole.any():
            yield corners[whole], place[whole], face[whole]
        for count, pattern in _PARTS.items():
            pick = divided.sum(axis=1) == count
            if not pick.any():
                continue
            # divided edges first
            turn = _turn(divided[pick])
            nodes = np.concatenate(
                [_turn_entries(corners[pick], turn), _turn_entries(middle[pick], turn)], axis=1
            )
            spots = np.concatenate(
                [_turn_entries(place[pick], turn), _turn_entries(between[pick], turn)], axis=1
            )
            parts = np.array(pattern)
            stack.append(
                (
                    nodes[:, parts].reshape(-1, 3, 3),
                    spots[:, parts].reshape(-1, 3, 2),
                    np.repeat(face[pick], len(pattern)),
                )
            )


def _turn(divided: NDArray[np.bool_]) -> I64:
    """(n,) edge to begin with, so that divided edges come first in turn."""
    before = np.roll(divided, 1, axis=1)
    return np.where(divided.all(axis=1), 0, np.argmax(divided & ~before, axis=1))


def _turn_entries(values: F64, turn: I64) -> F64:
    """Entries (n, 3, m) of the corners in turn from another one."""
    order = (turn[:, None] + np.arange(3)) % 3
    return np.take_along_axis(values, order[..., None], axis=1)


def _fill_triangles(corners: F64, place: F64, face: I64, shape: tuple[int, int]) -> Iterator[Fragments]:
    """Points of straight triangles at the centres of pixels, some rows of pixels at a time."""
    rows, columns = shape
    low = np.clip(np.ceil(place[..., 0].min(axis=1)), 0, rows).astype(np.int64)
    high = np.clip(np.ceil(place[..., 0].max(axis=1)), 0, rows).astype(np.int64)
    a, b = place[:, 1] - place[:, 0], place[:, 2] - place[:, 0]
    twice = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
    beside = (place[..., 1].max(axis=1) < 0.0) | (place[..., 1].min(axis=1) > columns - 1)
    height = np.where((twice == 0.0) | beside, 0, high - low)
    pick = np.flatnonzero(height)
    ends = np.cumsum(height[pick])
    for start, end in _groups(ends):
        own = np.repeat(pick[start:end], height[pick[start:end]])
        first = np.repeat(ends[start:end] - height[pick[start:end]], height[pick[start:end]])
        line = low[own] + np.arange(ends[start - 1] if start else 0, ends[end - 1]) - first
        left, right = _crossings(place[own], line)
        begin = np.clip(np.ceil(left), 0, columns).astype(np.int64)
        count = np.clip(np.ceil(right), 0, columns).astype(np.int64) - begin
        total = np.cumsum(count)
        for part, stop in _groups(total):
            n = count[part:stop]
            column = np.arange(int(n.sum())) - np.repeat(np.cumsum(n) - n, n) + np.repeat(begin[part:stop], n)
            row, i = np.repeat(line[part:stop], n), np.repeat(own[part:stop], n)
            d = np.stack([row, column], axis=1) - place[i, 0]
            u = (d[:, 0] * b[i, 1] - d[:, 1] * b[i, 0]) / twice[i]
            v = (a[i, 0] * d[:, 1] - a[i, 1] * d[:, 0]) / twice[i]
            one, two = corners[i, 1] - corners[i, 0], corners[i, 2] - corners[i, 0]
            yield Fragments(
                row * columns + column,
                face[i],
                corners[i, 0] + u[:, None] * one + v[:, None] * two,
                np.linalg.norm(np.cross(one, two), axis=1) / np.abs(twice[i]),
            )


def _groups(ends: I64) -> Iterator[tuple[int, int]]:
    """First and last entry of groups of entries whose sizes, with these running sums, add up to about ``_SPANS``."""
    start = 0
    while start < len(ends):
        done = int(ends[start - 1]) if start else 0
        stop = max(start + 1, int(np.searchsorted(ends, done + _SPANS, side="right")))
        yield start, stop
        start = stop


def _crossings(place: F64, line: I64) -> tuple[F64, F64]:
    """Columns (n,) at which rows of pixels enter and leave triangles (n, 3, 2); an edge gives both sides the same."""
    left, right = np.full(len(line), np.inf), np.full(len(line), -np.inf)
    for k in range(3):
        p, q = place[:, k], place[:, (k + 1) % 3]
        swap = (p[:, 0] > q[:, 0]) | ((p[:, 0] == q[:, 0]) & (p[:, 1] > q[:, 1]))
        p, q = np.where(swap[:, None], q, p), np.where(swap[:, None], p, q)
        met = (p[:, 0] <= line) & (line < q[:, 0])
        with np.errstate(invalid="ignore", divide="ignore"):
            at = p[:, 1] + (line - p[:, 0]) / (q[:, 0] - p[:, 0]) * (q[:, 1] - p[:, 1])
        left = np.where(met, np.minimum(left, at), left)
        right = np.where(met, np.maximum(right, at), right)
    none = ~np.isfinite(left)
    return np.where(none, 0.0, left), np.where(none, 0.0, right)


VALID, SHADOW, LAYOVER, BOTH, NO_SURFACE = 0, 1, 2, 3, 255
MASK_CODES = {
    VALID: "valid",
    SHADOW: "shadow",
    LAYOVER: "layover",
    BOTH: "layover and shadow",
    NO_SURFACE: "no surface",
}
# points of one pixel closer than this, m, and in pixels, are on one surface: faces that lie on each other
_SAME, _SAME_PIXELS = 1e-3, 0.02
# share of the range by which that of closest approach may differ from a pixel's, for triangles without a place
_MARGIN = 0.05
# places in the image are rounded to this part of a pixel, so that rounding does not open gaps between triangles
_ROUNDED = 2.0**-16


@dataclass(frozen=True, eq=False)
class SurfacePoints:
    """Points of surfaces in the pixels of an image, and whether the antenna sees them.

    Parameters
    ----------
    found : points, ordered by pixel; ``face`` counts in the scene's geometry
    seen : (n,) whether a line of sight to the antenna at the middle of the point's aperture is free
    hider : (n,) face that hides it; -1 where it is seen
    open : (n,) of a hidden point whether nothing is above it; True for seen ones
    incidence : (n,) float64, rad, between the surface's normal and the line to the antenna, 0 ... pi/2
    shape : rows and columns of the image
    """

    found: Fragments
    seen: NDArray[np.bool_]
    hider: I64
    open: NDArray[np.bool_]
    incidence: F64
    shape: tuple[int, int]

    @property
    def counted(self) -> NDArray[np.bool_]:
        """(n,) points that count as hidden surfaces in a pixel that shows others too."""
        return ~self.seen & self.open

    def number(self, which: NDArray[np.bool_]) -> I64:
        """Number of selected points in each pixel, (azimuth, range)."""
        count = np.bincount(self.found.pixel[which], minlength=self.shape[0] * self.shape[1])
        return np.asarray(count, dtype=np.int64).reshape(self.shape)

    def first(self, rank: F64) -> I64:
        """Point of the least rank (n,) in each pixel, (azimuth, range); -1 where there is none."""
        order = np.lexsort((rank, self.found.pixel))
        out = np.full(self.shape[0] * self.shape[1], -1, dtype=np.int64)
        pixels, first = np.unique(self.found.pixel[order], return_index=True)
        out[pixels] = order[first]
        return out.reshape(self.shape)


def check_labelled(radar: Radar) -> None:
    """Raise a DataError for a track around the scene, whose image has neither one shadow nor one side of layover."""
    if radar.all_round:
        raise DataError(
            "labels: the track sees the scene from opposite sides, so that its image has neither one shadow nor one "
            "direction of layover; label an image of a part of the track"
        )


def surface_points(scene: Scene, grid: ImageGrid) -> SurfacePoints:
    """Points of all surfaces of a scene that fall on the centres of an image's pixels.

    Parameters
    ----------
    scene : at time zero; moving meshes are shown where their range history places them
    grid : of the image, in any frame

    Raises
    ------
    DataError
        The track goes round the scene, so that an image has no one direction of range.
    """
    radar, geometry = scene.radar, scene.geometry
    check_labelled(radar)
    grid = grid.in_frame(scene.offset)
    placement = ImagePlacement(grid, radar)
    invisible = np.array([m.invisible for m in scene.materials], dtype=bool)
    solid = np.flatnonzero(~invisible[geometry.face_material]) if geometry.n_faces else np.zeros(0, np.int64)
    corners = geometry.vertices[geometry.faces[solid]]
    middle, found = radar.start_stop().track.center_position, []
    for motion, rows in _group_by_motion(geometry, solid):
        placed = _PixelPlaces(placement, motion)
        one = fragments(corners[rows], placed, grid.shape, middle, placed.reached)
        whole = Fragments(one.pixel, rows[one.face], one.point, one.area)
        found += [whole, _smaller_than_a_pixel(geometry, solid, rows, whole, placed)]
    points = Fragments.joined(found)
    points = points[np.argsort(points.pixel, kind="stable")]
    n = len(points.pixel)
    if not n:
        none = np.zeros(0, dtype=bool)
        return SurfacePoints(points, none, points.face, none, np.zeros(0), grid.shape)
    sight, antenna = SightLines(corners), placement.antenna(points.point)
    hider = sight.hidden_by(points.point, points.face, antenna)
    line = antenna - points.point
    cosine = np.abs(np.einsum("ij,ij->i", sight.normal[points.face], line)) / np.linalg.norm(line, axis=1)
    seen = hider < 0
    free = np.ones(n, dtype=bool)
    free[~seen] = sight.open_to_the_sky(points.point[~seen], points.face[~seen])
    own = Fragments(points.pixel, solid[points.face], points.point, points.area)
    spacing = min(grid.azimuth_spacing, grid.range_spacing)
    kept = _apart(own, seen, max(_SAME, _SAME_PIXELS * spacing))
    return SurfacePoints(
        own[kept],
        seen[kept],
        np.where(seen, -1, solid[hider])[kept],
        free[kept],
        np.arccos(np.clip(cosine, 0.0, 1.0))[kept],
        grid.shape,
    )


@dataclass(frozen=True, eq=False)
class _PixelPlaces:
    """Row and column, in pixels, of points that move alike; NaN on the side that the radar does not look to."""

    placement: ImagePlacement
    motion: Motion

    @cached_property
    def _closest(self) -> tuple[float, float]:
        """Least and largest range of closest approach in the image, with a margin for curved tracks and movement, m."""
        grid = self.placement.grid
        ends = replace(grid, azimuth=grid.azimuth[[0, -1]], range=grid.range[[0, -1]])
        found = _slant_position(self.placement.radar, ends)[..., 1]
        return float(found.min()) * (1.0 - _MARGIN), float(found.max()) * (1.0 + _MARGIN)

    def reached(self, middle: F64, radius: F64) -> NDArray[np.bool_]:
        """Whether spheres about points (n, 3) of radii (n,), m, may hold something of the image."""
        track = self.placement.radar.track
        leg = middle - track.center_position
        closest = np.linalg.norm(leg - (leg @ track.along)[:, None] * track.along, axis=1)
        least, largest = self._closest
        return np.asarray((closest + radius > least) & (closest - radius < largest))

    def __call__(self, points: F64) -> F64:
        grid, radar = self.placement.grid, self.placement.radar
        azimuth, range_ = self.placement.locate(points, self.motion)
        row = (azimuth - grid.azimuth[0]) / grid.azimuth_spacing
        column = (range_ - grid.range[0]) / grid.range_spacing
        place = np.round(np.stack([row, column], axis=1) / _ROUNDED) * _ROUNDED
        place[(points - radar.track.center_position) @ radar.across <= 0.0] = np.nan
        return np.asarray(place)


def _group_by_motion(geometry: Geometry, solid: I64) -> list[tuple[Motion, I64]]:
    """Motions, and the entries of ``solid`` (faces of the geometry) that have each."""
    still = np.ones(len(solid), dtype=bool)
    parts = []
    for motion, rows in geometry.moving_meshes():
        own = (solid >= rows.start) & (solid < rows.stop)
        still &= ~own
        parts.append((motion, np.flatnonzero(own)))
    return [(STILL, np.flatnonzero(still)), *parts]


def _smaller_than_a_pixel(
    geometry: Geometry, solid: I64, rows: I64, found: Fragments, placed: _PixelPlaces
) -> Fragments:
    """One point of every shape that covers no centre of a pixel: the middle of the face nearest to the shape's middle.

    Parameters
    ----------
    solid, rows : faces of the geometry, and entries of these that move alike
    found : points of these; ``face`` counts in ``solid``
    """
    shape = geometry.face_object[solid]
    rows = rows[~np.isin(shape[rows], np.unique(shape[found.face]))]
    corners = geometry.vertices[geometry.faces[solid[rows]]]
    sides = corners[:, 1:] - corners[:, :1]
    area = 0.5 * np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1)
    own, number = np.unique(shape[rows], return_inverse=True)
    total = np.maximum(np.bincount(number, area, len(own)), 1e-300)
    faces = corners.mean(axis=1)
    middle = np.stack([np.bincount(number, area * faces[:, k], len(own)) / total for k in range(3)], axis=1)
    order = np.lexsort((np.linalg.norm(faces - middle[number], axis=1), number))
    nearest = order[np.searchsorted(number[order], np.arange(len(own)))]
    place = np.rint(placed(faces[nearest]))
    lines, columns = placed.placement.grid.shape
    inside = ((place >= 0.0) & (place < [lines, columns])).all(axis=1)  # NaN: no place
    pixel = (place[inside] @ [columns, 1]).astype(np.int64)
    nearest = nearest[inside]
    return Fragments(pixel, rows[nearest], faces[nearest], total[inside])


def _apart(found: Fragments, seen: NDArray[np.bool_], nearest: float) -> I64:
    """Entries that are left when of points of a pixel closer than ``nearest``, m, one is kept, a seen one if any is."""
    order = np.lexsort((found.point[:, 2], found.pixel))
    a, b = order[:-1], order[1:]
    same = found.pixel[a] == found.pixel[b]
    same &= np.linalg.norm(found.point[a] - found.point[b], axis=1) < nearest
    kept = np.ones(len(order), dtype=bool)
    kept[np.where(seen[b] & ~seen[a], a, b)[same]] = False
    return np.flatnonzero(kept)


GEOMETRIC_LAYERS = (
    "layover_shadow",
    "surfaces",
    "hidden_surfaces",
    "local_incidence_angle",
    "ground_position",
    "surface_position",
    "slant_position",
    "shape",
    "part",
    "shadow_of",
)


def geometric_layers(scene: Scene, grid: ImageGrid, points: SurfacePoints) -> dict[str, LabelLayer]:
    """Layers of a scene's geometry, by name.

    Parameters
    ----------
    scene, grid : of the image
    points : of :func:`surface_points`

    Notes
    -----
    Of several surfaces in a pixel, ``surface_position``, ``local_incidence_angle`` and ``shape`` are those of the one
    with the largest area in the pixel, a seen one where there is one.
    """
    seen, hidden = points.number(points.seen), points.number(points.counted)
    mask = np.full(grid.shape, NO_SURFACE, dtype=np.uint8)
    mask[points.number(~points.seen) > 0] = SHADOW
    mask[(seen == 1) & (hidden == 0)] = VALID
    mask[(seen > 1) & (hidden == 0)] = LAYOVER
    mask[(seen > 0) & (hidden > 0)] = BOTH
    found, height = points.found, points.found.point[:, 2]
    # seen ones first, then hidden ones that nothing is above
    rank = np.where(points.seen, 0.0, np.where(points.open, 2.0, 4.0))
    main = points.first(rank - found.area / (1.0 + found.area))
    low = points.first(np.where(points.seen | points.open, 0.0, 1e9) + height)
    geometry = scene.geometry
    names, part_names = (
        {0: "none"} | {i + 1: name for i, name in enumerate(every)}
        for every in (geometry.object_names, geometry.mesh_names)
    )
    face_object = geometry.face_object
    shape = np.where(seen > 0, _pick_values(main, face_object[found.face] + 1, 0), 0)
    part = np.where(seen > 0, _pick_values(main, geometry.face_mesh[found.face] + 1, 0), 0)
    dark = _pick_values(main, np.where(points.hider >= 0, face_object[points.hider] + 1, 0), 0)
    in_frame = found.point + scene.offset
    return {
        "layover_shadow": LabelLayer(
            mask, "", "layover and shadow by geometry, codes as isce3's", codes=MASK_CODES
        ),
        "surfaces": LabelLayer(
            seen.astype(np.uint16), "", "number of surfaces that fall into the pixel and are seen"
        ),
        "hidden_surfaces": LabelLayer(
            hidden.astype(np.uint16),
            "",
            "number of surfaces open to the sky that fall into the pixel and are not seen",
        ),
        "local_incidence_angle": LabelLayer(
            _pick_values(main, np.where(points.seen, points.incidence, np.nan), np.nan).astype(np.float32),
            "rad",
            "between the surface's normal and the line to the antenna; NaN where no surface is seen",
        ),
        "ground_position": LabelLayer(
            _pick_values(low, in_frame, np.nan),
            "m",
            "place of the lowest surface of the pixel, seen or not, in the frame of the file; NaN: no surface",
            parts=("x", "y", "height"),
        ),
        "surface_position": LabelLayer(
            _pick_values(main, in_frame, np.nan),
            "m",
            "place of the surface with the largest area in the pixel, in the frame of the file; NaN: no surface",
            parts=("x", "y", "height"),
        ),
        "slant_position": LabelLayer(
            _slant_position(scene.radar, grid),
            "m",
            "azimuth along the track from its middle, and slant range of closest approach, of the pixel itself",
            parts=("azimuth", "slant_range"),
        ),
        "shape": LabelLayer(
            shape.astype(np.int32),
            "",
            "shape of the seen surface with the largest area in the pixel",
            codes=names,
        ),
        "part": LabelLayer(
            part.astype(np.int32), "", "part of that shape: the mesh of the scene", codes=part_names
        ),
        "shadow_of": LabelLayer(
            np.where(mask == SHADOW, dark, 0).astype(np.int32),
            "",
            "shape that hides the surface of a pixel in shadow",
            codes=names,
        ),
    }


def _pick_values(index: I64, values: NDArray[np.generic], none: float) -> NDArray[np.generic]:
    """Values (n,) or (n, m) of the points of an index (azimuth, range), ``none`` where that is -1."""
    out = np.full((*index.shape, *values.shape[1:]), none, dtype=values.dtype)
    out[index >= 0] = values[index[index >= 0]]
    return out


def _slant_position(radar: Radar, grid: ImageGrid) -> F64:
    """Azimuth and slant range of closest approach of every pixel, (azimuth, range, 2) float64, m."""
    track = radar.track
    leg = grid.positions() - track.center_position
    azimuth = leg @ track.along
    return np.stack([azimuth, np.sqrt(np.sum(leg**2, axis=-1) - azimuth**2)], axis=-1)


def geometric_notes(scene: Scene) -> tuple[str, ...]:
    """Notes on parts of a scene that the geometric labels leave out, a line each."""
    notes = []
    bare = len(scene.points) + len(scene.scatterers) - len(scene.bodies)
    if bare:
        notes.append(
            f"{bare} point targets, wires and scatterers have no surface: they are in no layer of geometry"
        )
    if scene.bodies:
        notes.append(f"{len(scene.bodies)} volumes count as transparent: no layover, and no shadow of theirs")
    if any(m.thickness for m in scene.materials):
        notes.append("slabs that waves go through count as opaque")
    if continue_ground(scene) is not scene:
        notes.append("ground beyond its rim, which has no clutter, counts as no surface")
    if scene.geometry.moves:
        notes.append("moving shapes lie where their Doppler puts them; their shadow is that at time zero")
    if scene.radar.receiver is not None and not scene.radar.receives_itself:
        notes.append("shadow, layover and incidence angle are those of the transmitter, not of the receiver")
    return tuple(notes)
