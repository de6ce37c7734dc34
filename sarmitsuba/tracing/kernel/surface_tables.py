"""Spatially varying surfaces in the kernel: tables of bitmaps (level, class of material), and the gamma texture."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING
from zlib import crc32

import numpy as np
from numpy.typing import NDArray

from sarmitsuba.core.arrays import F32, F64, I32, I64, U32
from sarmitsuba.machine.backend import dr, mi
from sarmitsuba.scene.materials.texture import (
    FIELD_LIMIT,
    QUANTILE_NODES,
    Bitmap,
    node_spacing,
    texture_amplitudes,
)
from sarmitsuba.tracing.kernel.device_arrays import device_array
from sarmitsuba.tracing.kernel.speckle import SurfacePlace, gaussian, mix

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from sarmitsuba.scene.geometry import Geometry
    from sarmitsuba.scene.materials.material import Material

# bits for the continuation of a bitmap beyond its edges, and for interpolation between its texels
_REPEAT, _SMOOTH = 1, 2
_ROOT_2 = 1.4142135623730951


@dataclass(frozen=True, eq=False)
class SurfaceTables:
    """Tables of the spatial variations of a scene's surfaces; None for kinds of variation that the scene has not.

    Parameters
    ----------
    levels : factor on sigma0
    classes : bits of a material in place of that of the face
    textures : (4 n_materials,) float32: one over the node spacing of the random field (1/m, 0: no texture), and as bits
        of float32 the first entry of its quantiles and a seed for the material
    quantiles : amplitude of the texture over its normal field, see
        :func:`sarmitsuba.scene.materials.texture.texture_amplitudes`; one row for each shape
    """

    levels: BitmapLayer | None
    classes: BitmapLayer | None
    textures: mi.Float | None
    quantiles: mi.Float | None

    @staticmethod
    def of(
        geometry: Geometry, rows: NDArray[np.intp], materials: Sequence[Material], bits: U32
    ) -> SurfaceTables | None:
        """Tables of a scene; None where every surface is uniform.

        Parameters
        ----------
        geometry : whose faces ``rows`` are traced
        materials : `sarmitsuba.scene.materials.texture.with_parts`
        bits : (n_materials,) bits of the materials in the kernel
        """
        triangles = geometry.vertices[geometry.faces[rows]]
        corners = {name: values[rows] for name, values in geometry.corner_values.items()}
        own = geometry.face_material[rows]
        levels = [None if m.maps is None else m.maps.level for m in materials]
        maps = [None if m.maps is None else m.maps.classes for m in materials]
        starts = np.cumsum([0, *(0 if c is None else len(c.materials) for c in maps)])
        starts += len(materials) - starts[-1]  # parts come after all others
        layers = (
            BitmapLayer.of(
                levels, triangles, corners, own, lambda values, _: values.astype(np.float32), 1.0, mi.Float
            ),
            BitmapLayer.of(
                [None if c is None else c.bitmap for c in maps],
                triangles,
                corners,
                own,
                lambda values, i: bits[starts[i] + values.astype(np.int64)],
                bits,
                mi.UInt32,
            ),
        )
        textures, quantiles = _texture_tables(materials)
        if textures is None and layers == (None, None):
            return None
        return SurfaceTables(*layers, textures, quantiles)

    def with_levels(self, materials: Sequence[Material]) -> SurfaceTables:
        """The same tables with the levels of other maps of the same shapes; ``materials``: as for :meth:`of`."""
        if self.levels is None:
            return self
        maps = [None if m.maps is None else m.maps.level for m in materials]
        return replace(self, levels=self.levels.with_values(maps))

    def without_texture(self) -> SurfaceTables | None:
        """The bitmaps alone, since the mean power of the texture is one; None without any."""
        if self.levels is None and self.classes is None:
            return None
        return replace(self, textures=None, quantiles=None)

    def amplitude(
        self,
        face: mi.UInt32,
        own: mi.UInt32,
        material: mi.UInt32,
        offset: mi.Vector3f,
        place: SurfacePlace,
        seed: mi.UInt32,
        active: mi.Bool,
    ) -> mi.Float:
        """Factor on the diffuse amplitude at a point: root of the map's level, times the amplitude of the texture.

        Parameters
        ----------
        own, material : number of the face's material, and of that at the place
        offset : m, from the face's vertex 0
        place : coordinates on the surface's lattice, with the surface's motion removed
        seed : of the scene
        """
        factor = mi.Float(1.0)
        if self.levels is not None:
            factor = dr.sqrt(dr.maximum(self.levels.smooth(face, own, offset, active), 0.0))
        if self.textures is not None:
            factor *= self._texture(material, place, seed, active)
        return factor

    def _texture(
        self, material: mi.UInt32, place: SurfacePlace, seed: mi.UInt32, active: mi.Bool
    ) -> mi.Float:
        r"""Amplitude of the gamma texture.

        .. math:: g = \sum_{ij} w_i w_j z_{ij}, \quad \sum_i w_i^2 = 1

        over the nine nodes about the point, each with a standard normal number hashed from its position: g is standard
        normal everywhere, and the table of quantiles maps it to a gamma distribution.
        """
        record = dr.gather(mi.Vector4f, self.textures, material, active)
        first, salt = (dr.reinterpret_array(mi.UInt32, x) for x in (record.y, record.z))
        spacing = mi.Float64(record.x)
        lines = []
        for x in (place.a * spacing, place.b * spacing):
            node = dr.floor(x + 0.5)
            t = mi.Float(x - node)
            w = (0.5 * dr.square(0.5 - t), 0.75 - dr.square(t), 0.5 * dr.square(0.5 + t))
            root = dr.rsqrt(dr.square(w[0]) + dr.square(w[1]) + dr.square(w[2]))
            lines.append((mi.Int32(node), [x * root for x in w]))
        (ia, wa), (ib, wb) = lines
        g = mi.Float(0.0)
        start = mix(seed ^ salt) + place.axis * 0x165667B1
        for i in range(3):
            row = mix(mi.UInt32(ia + (i - 1)) * 0x9E3779B1 + start)
            for j in range(3):
                key = mix(row ^ (mi.UInt32(ib + (j - 1)) * 0x85EBCA77 + 0x27D4EB2F))
                g += wa[i] * wb[j] * (gaussian(key, 0).real * _ROOT_2)
        x = (dr.clip(g, -FIELD_LIMIT, FIELD_LIMIT) + FIELD_LIMIT) * (
            (QUANTILE_NODES - 1) / (2.0 * FIELD_LIMIT)
        )
        node = dr.minimum(mi.UInt32(x), QUANTILE_NODES - 2)
        low, high = (dr.gather(mi.Float, self.quantiles, first + node + i, active) for i in (0, 1))
        return dr.select(record.x > 0.0, low + (high - low) * (x - mi.Float(node)), 1.0)


@dataclass(frozen=True, eq=False)
class BitmapLayer:
    """Bitmaps of one kind, one or none for each material.

    Parameters
    ----------
    places : (8 n_faces,) float32: u at vertex 0 of each face and its gradient (1/m), then the same of v
    bitmaps : (4 n_materials,) uint32: first texel, columns, rows and bits of each material's bitmap; a material
        without one has a single texel
    texels : of all bitmaps
    """

    places: mi.Float
    bitmaps: mi.UInt32
    texels: mi.Float | mi.UInt32

    @staticmethod
    def of(
        bitmaps: Sequence[Bitmap | None],
        triangles: F64,
        corners: Mapping[str, F64],
        face_material: I32,
        texels_of: Callable[[F64 | I64, int], F32 | U32],
        own: float | U32,
        kind: type[mi.Float] | type[mi.UInt32],
    ) -> BitmapLayer | None:
        """Tables of a layer; None where no material has a bitmap.

        Parameters
        ----------
        bitmaps : of each material
        triangles : (n_faces, 3, 3) float64, m
        corners : attributes of the mesh at those corners
        face_material : (n_faces,)
        texels_of : function of a bitmap's values and its material's number that gives the texels
        own : texel of a material without a bitmap, one for all or (n_materials,)
        kind : of texels on the device
        """
        if not any(bitmaps):
            return None
        places = np.zeros((len(triangles), 2, 4))
        texels = [np.broadcast_to(own, len(bitmaps)).astype(np.float32 if np.isscalar(own) else np.uint32)]
        records = np.stack([np.arange(len(bitmaps)), *np.ones((2, len(bitmaps)), dtype=int)], axis=1)
        records = np.column_stack([records, np.zeros(len(bitmaps), dtype=int)]).astype(np.uint32)
        filled = len(bitmaps)
        for i, bitmap in enumerate(bitmaps):
            if bitmap is None:
                continue
            rows, columns = bitmap.values.shape
            records[i] = filled, columns, rows, _REPEAT * bitmap.repeat + _SMOOTH * bitmap.smooth
            texels.append(texels_of(bitmap.values, i).reshape(-1))
            filled += rows * columns
            faces = face_material == i
            at = {name: values[faces] for name, values in corners.items()}
            places[faces] = _affine(triangles[faces], bitmap.placement.at(triangles[faces], at))
        return BitmapLayer(
            device_array(mi.Float, places.astype(np.float32)),
            device_array(mi.UInt32, records),
            device_array(kind, np.concatenate(texels)),
        )

    def nearest(
        self, face: mi.UInt32, material: mi.UInt32, offset: mi.Vector3f, active: mi.Bool
    ) -> mi.UInt32:
        """Texel nearest to a point, ``offset`` (m) from the face's vertex 0."""
        record = dr.gather(mi.Vector4u, self.bitmaps, material, active)
        u, v = self._uv(face, offset, active)
        column, row = (
            _wrap_index(dr.floor(x * mi.Float(n)), n, record.w) for x, n in ((u, record.y), (v, record.z))
        )
        return dr.gather(type(self.texels), self.texels, record.x + row * record.y + column, active)

    def smooth(self, face: mi.UInt32, material: mi.UInt32, offset: mi.Vector3f, active: mi.Bool) -> mi.Float:
        """Value at a point, bilinear where the bitmap is smooth."""
        corners, tu, tv = self._corners(face, material, offset, active)
        lines = [
            dr.lerp(*(dr.gather(mi.Float, self.texels, c, active) for c in line), tu) for line in corners
        ]
        return dr.lerp(lines[0], lines[1], tv)

    def shares(
        self, face: mi.UInt32, material: mi.UInt32, offset: mi.Vector3f, active: mi.Bool
    ) -> tuple[tuple[mi.UInt32, mi.Float], ...]:
        """Numbers of the four texels whose bilinear mean is the value at a point, and the share of each in it."""
        corners, tu, tv = self._corners(face, material, offset, active)
        parts = [
            (c, dr.gather(mi.Float, self.texels, c, active) * (wu * wv))
            for line, wv in zip(corners, (1.0 - tv, tv), strict=True)
            for c, wu in zip(line, (1.0 - tu, tu), strict=True)
        ]
        whole = sum((value for _, value in parts), mi.Float(0.0))
        inverse = dr.select(whole > 0.0, dr.rcp(dr.select(whole > 0.0, whole, 1.0)), 0.0)
        return tuple((c, value * inverse) for c, value in parts)

    def first_texel(self, material: int) -> int:
        """Number of the first texel of a material's bitmap."""
        return int(np.array(self.bitmaps).reshape(-1, 4)[material, 0])

    def with_values(self, bitmaps: Sequence[Bitmap | None]) -> BitmapLayer:
        """The same layer of float values with other ones in bitmaps of the same shape."""
        own = np.array(self.texels)
        for i, bitmap in enumerate(bitmaps):
            if bitmap is not None:
                first = self.first_texel(i)
                own[first : first + bitmap.values.size] = bitmap.values.reshape(-1)
        return replace(self, texels=device_array(mi.Float, own.astype(np.float32)))

    def _corners(
        self, face: mi.UInt32, material: mi.UInt32, offset: mi.Vector3f, active: mi.Bool
    ) -> tuple[list[list[mi.UInt32]], mi.Float, mi.Float]:
        """Numbers of the texels of two rows and two columns about a point, and its place between them."""
        record = dr.gather(mi.Vector4u, self.bitmaps, material, active)
        u, v = self._uv(face, offset, active)
        shift = dr.select((record.w & _SMOOTH) != 0, 0.5, 0.0)
        axes = []
        for x, n in ((u, record.y), (v, record.z)):
            at = x * mi.Float(n) - shift
            first = dr.floor(at)
            ends = [_wrap_index(first + i, n, record.w) for i in (0, 1)]
            axes.append((ends, dr.select(shift > 0.0, at - first, 0.0)))
        (columns, tu), (rows, tv) = axes
        return [[record.x + row * record.y + c for c in columns] for row in rows], tu, tv

    def _uv(self, face: mi.UInt32, offset: mi.Vector3f, active: mi.Bool) -> tuple[mi.Float, mi.Float]:
        lines = (dr.gather(mi.Vector4f, self.places, face * 2 + i, active) for i in (0, 1))
        u, v = (line.x + dr.dot(mi.Vector3f(line.y, line.z, line.w), offset) for line in lines)
        return u, v


def _wrap_index(index: mi.Float, size: mi.UInt32, bits: mi.UInt32) -> mi.UInt32:
    """Index of a texel along one axis, from an integer that may lie beyond the bitmap's edges."""
    n = mi.Float(size)  # 0 in lanes that are not active, where an integer division would stop the processor
    around = index - n * dr.floor(index / dr.maximum(n, 1.0))
    return mi.UInt32(dr.clip(dr.select((bits & _REPEAT) != 0, around, index), 0.0, dr.maximum(n, 1.0) - 1.0))


def _affine(triangles: F64, uv: F64) -> F64:
    """Value at vertex 0 and gradient in the triangle's plane, (n, 2, 4), of ``uv``, (n, 3, 2) at its corners."""
    e1, e2 = triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    normal = np.cross(e1, e2)
    # gradients that are 1 along one edge and 0 along the other
    along = (
        np.stack([np.cross(e2, normal), np.cross(normal, e1)], axis=1)
        / np.square(normal).sum(axis=1)[:, None, None]
    )
    change = np.stack([uv[:, 1] - uv[:, 0], uv[:, 2] - uv[:, 0]], axis=1)
    gradient = np.einsum("nek,nei->nki", change, along)
    return np.concatenate([uv[:, 0, :, None], gradient], axis=2)


def _texture_tables(materials: Sequence[Material]) -> tuple[mi.Float | None, mi.Float | None]:
    """Table of the materials' textures and the quantiles of their gamma distributions; None without textures."""
    shapes = sorted({m.texture_shape for m in materials if m.texture_shape > 0.0})
    if not shapes:
        return None, None
    records = np.zeros((len(materials), 4), dtype=np.float32)
    numbers = records.view(np.uint32)
    for i, m in enumerate(materials):
        if m.texture_shape > 0.0:
            records[i, 0] = 1.0 / (m.texture_length * node_spacing(m.texture_shape))
            numbers[i, 1] = shapes.index(m.texture_shape) * QUANTILE_NODES
            numbers[i, 2] = crc32(m.name.encode())  # the same wherever the file lists the material
    tables = np.stack([texture_amplitudes(shape) for shape in shapes])
    return device_array(mi.Float, records), device_array(mi.Float, tables.astype(np.float32))
