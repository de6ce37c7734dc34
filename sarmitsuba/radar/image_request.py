"""Image request: grid, centre, extent and pixel spacing, automatic values fitted to the geometry.

The extent of the scatterers is their outline; its middle is the default aim point.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from sarmitsuba.core.arrays import F64, I32, box_of_each
from sarmitsuba.core.errors import RadarError
from sarmitsuba.radar.film import FilmDescription
from sarmitsuba.radar.swath import Box

MAX_PIXELS = 2**30  # most pixels of one image plane: 8 GiB
MAX_CELLS = 2048  # default limit of automatic extents in cells: an image of 4096 x 4096 pixels at half a cell
# automatic margin on every side: cells for side lobes, and a share of the extent
_MARGIN_CELLS, _NARROW_MARGIN_CELLS = 16, 4
# azimuth cells by which ghosts from the fade-out zone stay outside the image, so that only side lobes reach in
_SKIRT_CELLS = 8.0


@dataclass(frozen=True)
class ImageRequest:
    """Requested image: grid, centre, extent and pixel spacing.

    Parameters
    ----------
    grid : ``slant`` or ``ground``
    center_x, center_y : m
    height : m; of the horizontal image plane
    extent_azimuth, extent_range : m on the ground
    spacing_azimuth, spacing_range : m; 0 = half a resolution cell
    pixels_azimuth, pixels_range : exact numbers of pixels about the centre; 0 = as many as cover the extent
    offset : m; positions in the frame of the user's file are those here + offset. Zeros, the default: centre and height
        are in the frame of the user's file, as whoever writes a request by hand counts them
    """

    grid: Literal["slant", "ground"] = "slant"
    center_x: float = 0.0
    center_y: float = 0.0
    height: float = 0.0
    extent_azimuth: float = 100.0
    extent_range: float = 100.0
    spacing_azimuth: float = 0.0
    spacing_range: float = 0.0
    pixels_azimuth: int = 0
    pixels_range: int = 0
    offset: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def scaled(self, share: float) -> "ImageRequest":
        """The same pixels of the middle of the image, ``share`` of each extent."""
        return replace(
            self._with_pixels(share),
            extent_azimuth=share * self.extent_azimuth,
            extent_range=share * self.extent_range,
        )

    def coarser(self, factor: float, spacing: tuple[float, float]) -> "ImageRequest":
        """The same area in pixels ``factor`` times as wide as ``spacing``, m."""
        return replace(
            self._with_pixels(1.0 / factor),
            spacing_azimuth=factor * spacing[0],
            spacing_range=factor * spacing[1],
        )

    def _with_pixels(self, share: float) -> "ImageRequest":
        """The same with that share of the numbers of pixels, where these are given."""
        azimuth, across = (
            max(1, round(share * n)) if n else 0 for n in (self.pixels_azimuth, self.pixels_range)
        )
        return replace(self, pixels_azimuth=azimuth, pixels_range=across)

    def fade_out(self, cell: float) -> float:
        """Width of the fade-out zone around the image, m: 5 % of half its longer side, 10 cells at least.

        Abruptly ending clutter would show a frame of side lobes.

        Parameters
        ----------
        cell : m, the coarser of the resolution cells
        """
        return max(0.025 * max(self.extent_azimuth, self.extent_range), 10.0 * cell)

    def in_frame(self, offset: ArrayLike = (0.0, 0.0, 0.0)) -> "ImageRequest":
        """The same image in the frame of another offset, (3,) m; by default in the frame of the user's file."""
        there = tuple(float(v) for v in np.asarray(offset, dtype=np.float64))
        if there == self.offset:
            return self
        x, y, z = (was - now for was, now in zip(self.offset, there, strict=True))
        return replace(
            self,
            center_x=self.center_x + x,
            center_y=self.center_y + y,
            height=self.height + z,
            offset=(there[0], there[1], there[2]),
        )

    def as_dict(self) -> dict[str, object]:
        """Values for JSON, in the frame of the user's file."""
        return {name: value for name, value in vars(self.in_frame()).items() if name != "offset"}


def build_image_request(
    film: FilmDescription,
    where: str,
    scene: Box,
    antenna: F64,
    cells: tuple[float, float],
    offset: F64,
) -> tuple[ImageRequest, tuple[str, ...]]:
    """Image request from ``range_film``, with automatic values filled in.

    Parameters
    ----------
    film, where : description, start of every error
    scene : bounds of all geometry about the aim point, in the axes along, across and up
    antenna : (3,) float64, m, mid-aperture position in the scene frame
    cells : azimuth cell and slant-range cell, m
    offset : (3,) m; scene frame = file frame - offset

    Returns
    -------
    request in the scene frame, and notes
    """
    aim = scene.origin
    center = np.array(
        [
            aim[0] if film.image_center_x is None else film.image_center_x - offset[0],
            aim[1] if film.image_center_y is None else film.image_center_y - offset[1],
        ]
    )
    height = aim[2] if film.image_height is None else film.image_height - offset[2]
    if antenna[2] <= height:
        raise RadarError(
            f"{where}: image_height = {height + offset[2]:g} m is not below the antenna at "
            f"{antenna[2] + offset[2]:g} m; raise the antenna or lower the image plane"
        )
    along, across = scene.axes[0, :2], scene.axes[1, :2]
    shift = center - aim[:2]
    middle = np.array([shift @ along, shift @ across])
    reach = float((center - antenna[:2]) @ across)  # from the track's ground trace to the image centre
    if reach <= 0.0:
        raise RadarError(
            f"{where}: the image centre lies {-reach:g} m behind the radar, on the side it does not look to; "
            "change look_side or image_center_x, image_center_y"
        )
    drop = float(antenna[2] - height)
    slant = float(np.hypot(reach, drop))
    ground_cell = cells[1] * slant / reach
    layover = max(0.0, float(scene.high[2]) - (height - aim[2])) * drop / reach

    def half(axis: int) -> float:
        return float(max(abs(scene.low[axis] - middle[axis]), abs(scene.high[axis] - middle[axis])))

    def fills(axis: int, cell: float) -> bool:
        return half(axis) >= 2.0 * _MARGIN_CELLS * cell

    def automatic(axis: int, cell: float, extra: float) -> tuple[float, float]:
        margin = _NARROW_MARGIN_CELLS if fills(axis, cell) else _MARGIN_CELLS
        return 2.0 * (half(axis) + margin * cell) + extra, film.image_extent_limit or MAX_CELLS * cell

    # layover extends to the near side only: an automatic centre moves there by half of it
    free = film.image_center_x is None and film.image_center_y is None
    one_sided = free and fills(1, ground_cell)
    notes = []
    extent_azimuth, extent_range = film.image_extent_azimuth, film.image_extent_range
    if film.pixels_azimuth:
        extent_azimuth = film.pixels_azimuth * (film.pixel_spacing_azimuth or 0.5 * cells[0])
    if film.pixels_range:
        extent_range = _extent_of_pixels(film, cells[1], reach, drop, where)
    if extent_azimuth == 0.0:
        wanted, most = automatic(0, cells[0], 0.0)
        extent_azimuth = min(wanted, most)
        notes += _note_limit(where, "image_extent_azimuth", wanted, most)
    if extent_range == 0.0:
        wanted, most = automatic(1, ground_cell, layover if one_sided else 2.0 * layover)
        if one_sided and wanted <= most:
            center = center - 0.5 * layover * across
            reach -= 0.5 * layover
        extent_range = min(wanted, most, 1.9 * reach)
        notes += _note_limit(where, "image_extent_range", wanted, most)
    elif 0.5 * extent_range >= reach:
        raise RadarError(
            f"{where}: image_extent_range = {extent_range:g} m reaches past the ground track of the radar, which is "
            f"{reach:g} m from the image centre; give less than {2 * reach:g} m"
        )
    request = ImageRequest(
        grid=film.image_grid,
        center_x=float(center[0]),
        center_y=float(center[1]),
        height=float(height),
        extent_azimuth=float(extent_azimuth),
        extent_range=float(extent_range),
        spacing_azimuth=film.pixel_spacing_azimuth,
        spacing_range=film.pixel_spacing_range,
        pixels_azimuth=film.pixels_azimuth,
        pixels_range=film.pixels_range,
        offset=(float(offset[0]), float(offset[1]), float(offset[2])),
    )
    _check_pixels(request, where, (cells[0], ground_cell if request.grid == "ground" else cells[1]))
    return request, tuple(notes)


def _extent_of_pixels(film: FilmDescription, cell: float, reach: float, drop: float, where: str) -> float:
    """Extent on the ground, m, that holds the number of pixels in range about ground range ``reach`` below ``drop``."""
    middle = float(np.hypot(reach, drop))
    if film.image_grid == "ground":
        return film.pixels_range * (film.pixel_spacing_range or 0.5 * cell * middle / reach)
    width = film.pixels_range * (film.pixel_spacing_range or 0.5 * cell)
    near = middle - 0.5 * width
    if near <= drop:
        raise RadarError(
            f"{where}: pixels_range = {film.pixels_range}, {width:g} m of slant range, reach past the ground track of "
            "the radar; take fewer"
        )
    return 2.0 * (reach - float(np.sqrt(near**2 - drop**2)))


def _note_limit(where: str, name: str, wanted: float, most: float) -> list[str]:
    """Note about an automatic extent that the limit cuts."""
    if wanted <= most:
        return []
    return [
        f"{where}: the image shows the middle {most:.4g} m of {wanted:.4g} m ({name}); raise image_extent_limit, "
        f"or give {name}, for a larger image"
    ]


def _check_pixels(image: ImageRequest, where: str, cells: tuple[float, float]) -> None:
    azimuth = image.pixels_azimuth or image.extent_azimuth / (image.spacing_azimuth or 0.5 * cells[0])
    across = image.pixels_range or image.extent_range / (image.spacing_range or 0.5 * cells[1])
    if max(azimuth, across, azimuth * across) > MAX_PIXELS:
        raise RadarError(
            f"{where}: an image of {azimuth:.4g} x {across:.4g} pixels is larger than {MAX_PIXELS} pixels; "
            "shrink its extents or widen its pixel spacings"
        )


def faded_box(box: Box, scene: Box, width: float, cell: float, *, all_round: bool) -> Box:
    """The image's box lengthened to the largest distance between a pixel and scatterers in the fade-out zone.

    A few cells are added, so that the main lobes of ghosts stay outside and not only their peaks.

    Parameters
    ----------
    box, scene : of the image and of all geometry, in the same axes
    width : of the fade-out, m
    cell : m, azimuth resolution
    all_round : the image is seen from every side, not only along the track
    """
    skirt = _SKIRT_CELLS * cell
    farthest = np.maximum(box.low - scene.low, scene.high - box.high)
    beyond = np.clip(farthest + skirt, 0.0, width + skirt)
    return replace(box, high=box.high + beyond * [1.0, float(all_round), 0.0])


def image_box(image: ImageRequest, scene: Box) -> Box:
    """Box over the image's area that reaches from the lowest to the highest geometry and the image plane."""
    shift = np.array([image.center_x, image.center_y]) - scene.origin[:2]
    middle = np.array([shift @ scene.axes[0, :2], shift @ scene.axes[1, :2]])
    half = 0.5 * np.array([image.extent_azimuth, image.extent_range])
    plane = image.height - float(scene.origin[2])
    low = np.array([*(middle - half), min(plane, float(scene.low[2]))])
    high = np.array([*(middle + half), max(plane, float(scene.high[2]))])
    return Box(scene.origin, scene.axes, low, high)


# m; faces that reach no higher above the level of the ground are ground, kerbs and pavements included
_ABOVE_GROUND = 0.5
# share of the plan that such ground covers in scenes on a plain; in others, such as terrain, bodies have walls
_PLAIN = 0.5
# cosine of the least slope of a wall, 60 degrees
_WALL = 0.5


@dataclass(frozen=True, eq=False)
class Extent:
    """Outline and middle of all scatterers, scene frame.

    Parameters
    ----------
    outline : (n, 3) float64, m; points whose convex hull contains all scatterers
    middle : (3,) float64, m; default aim point: the middle of the outline, on the ground
    faces : (n_faces, 3) triangles of the first points of the outline; None: the outline is a hull, filled with
        scatterers. Points of no triangle are scatterers too
    endless : (n, 3) float64, m; corners of ground without end, which automatic sizes do not count; None: none
    """

    outline: F64
    middle: F64
    faces: I32 | None = None
    endless: F64 | None = None

    @staticmethod
    def of_box(low: F64, high: F64) -> "Extent":
        """Extent of an axis-parallel box with the ground at its bottom; (3,) lower and upper corner, m."""
        ends = np.stack([low, high])
        corners = np.array(
            [[ends[i, 0], ends[j, 1], ends[k, 2]] for i in (0, 1) for j in (0, 1) for k in (0, 1)]
        )
        return Extent(corners, np.array([*(0.5 * (ends[0] + ends[1])[:2]), ends[0, 2]]))

    def in_axes(self, origin: F64, axes: F64) -> tuple[F64, F64]:
        """Lower and upper corner (3,) of the outline's box, from ``origin``, along the rows of ``axes``."""
        local = (self.outline - origin) @ axes.T
        return local.min(axis=0), local.max(axis=0)

    def lit_in_axes(self, origin: F64, axes: F64) -> tuple[F64, F64]:
        """The same with ground without end."""
        if self.endless is None:
            return self.in_axes(origin, axes)
        return replace(self, outline=np.concatenate([self.outline, self.endless])).in_axes(origin, axes)

    @cached_property
    def bodies(self) -> I32:
        """Triangles without the ground, (n, 3).

        On a plain they are all that reach above it; on terrain the walls, all triangles where there are none.
        """
        assert self.faces is not None
        if not len(self.faces):
            return self.faces
        corners = self.outline[self.faces]
        normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        plan, area = 0.5 * np.abs(normal[:, 2]), 0.5 * np.linalg.norm(normal, axis=1)
        low = corners[..., 2].max(axis=1) <= self.middle[2] + _ABOVE_GROUND
        sides = np.ptp(corners[..., :2].reshape(-1, 2), axis=0)
        if plan[low].sum() >= _PLAIN * float(np.prod(sides)):
            picked = ~low
        else:
            picked = (plan < _WALL * area) & ~low
        return self.faces[picked] if picked.any() else self.faces

    def is_empty(self, center: F64, reach: float) -> bool:
        """Whether no body and no point lies within a horizontal distance ``reach`` of ``center``, (2,), m."""
        if self.faces is None:
            return False
        # all of a small scene is near: its triangles need not be looked at
        if (np.hypot(*(self.outline[:, :2] - center).T) <= reach).all():
            return False
        low, high, _ = self._parts(self.bodies)
        gap = np.maximum(np.maximum(low - center, center - high), 0.0)
        return bool((np.linalg.norm(gap, axis=1) > reach).all())

    def densest(self, size: float) -> "Extent":
        """The same with the middle in the square of ``size``, m, that holds the largest area of bodies.

        Squares overlap by half; an ideal point counts as one square metre.
        """
        assert self.faces is not None
        low, high, area = self._parts(self.bodies)
        places = 0.5 * (low + high)
        cell = np.floor((places - places.min(axis=0)) / (0.5 * size)).astype(np.int64)
        cells, index = np.unique(cell, axis=0, return_inverse=True)
        held = np.bincount(index.reshape(-1), area)
        total = {tuple(c): float(h) for c, h in zip(cells.tolist(), held, strict=True)}
        corner = max(
            total, key=lambda c: sum(total.get((c[0] + i, c[1] + j), 0.0) for i in (0, 1) for j in (0, 1))
        )
        inside = ((cell >= corner) & (cell <= np.add(corner, 1))).all(axis=1)
        ends = np.clip([low[inside].min(axis=0), high[inside].max(axis=0)], *_around(places[inside], size))
        return replace(self, middle=np.array([*ends.mean(axis=0), self.middle[2]]))

    def _parts(self, faces: I32) -> tuple[F64, F64, F64]:
        """Horizontal bounds (n, 2) of triangles and of points of none, and their areas (n,), m^2."""
        corners = self.outline[faces]
        across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        alone = np.ones(len(self.outline), dtype=bool)
        alone[self.faces] = False
        points = self.outline[alone, :2]
        low, high = box_of_each(corners[..., :2])
        return (
            np.concatenate([low, points]),
            np.concatenate([high, points]),
            np.concatenate([0.5 * np.linalg.norm(across, axis=1), np.ones(len(points))]),
        )


def _around(places: F64, size: float) -> tuple[F64, F64]:
    """Corners of the square of ``size`` about the middle of places, (2,) each."""
    middle = 0.5 * (places.min(axis=0) + places.max(axis=0))
    return middle - 0.5 * size, middle + 0.5 * size
