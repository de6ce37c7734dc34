"""Maps of materials in a scene file: bitmaps and mesh attributes, nested in a BSDF."""

import os
import warnings
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from sarmitsuba.core.arrays import F64, I64
from sarmitsuba.core.errors import DataError, SceneError
from sarmitsuba.core.parameters import Value, did_you_mean, one_line, string_value
from sarmitsuba.core.units import power_from_db
from sarmitsuba.loading.elements import Element
from sarmitsuba.machine.backend import mi
from sarmitsuba.machine.isolated import survive
from sarmitsuba.machine.regular_files import check_regular, check_unpacked
from sarmitsuba.scene.materials.map_materials import vary_material
from sarmitsuba.scene.materials.material import ClassMap, Material, SurfaceMaps
from sarmitsuba.scene.materials.texture import (
    ATTRIBUTE_TEXELS,
    Bitmap,
    Placement,
    place_in_plan,
    place_on_mesh,
)

T = TypeVar("T")
# of ``radar_material`` and of ``land_cover``
LEVEL_MAP, PERMITTIVITY_MAP, ROUGHNESS_MAP, CLASS_MAP = (
    "sigma0_map",
    "permittivity_map",
    "roughness_map",
    "class_map",
)
MATERIAL_MAPS = (LEVEL_MAP, PERMITTIVITY_MAP, ROUGHNESS_MAP)
MAP_NAMES = (*MATERIAL_MAPS, CLASS_MAP)
# parameters of Mitsuba's textures that have a meaning here, by plugin
_TEXTURES = {
    "bitmap": ("filename", "raw", "filter_type", "wrap_mode", "to_uv"),
    "mesh_attribute": ("name",),
}
# a bitmap takes about 20 bytes a pixel while it is read: 1.3 GB
MOST_PIXELS = 1 << 26
_EXR = b"\x76\x2f\x31\x01"
_EXR_CHANNEL = 4  # bytes of a number; half floats are unpacked to this size
_NUMBER, _COLOUR = "class_", "color_"


def add_maps(material: Material, bsdf: Element, values: Mapping[str, Value | None]) -> Material:
    """Material with the maps of its element; unchanged where there are none.

    Parameters
    ----------
    material : without maps
    bsdf : ``radar_material``
    values : its validated parameters

    Raises
    ------
    SceneError : a map cannot be read or has no effect
    """
    found = {name: child for name, child in bsdf.children if name in MATERIAL_MAPS}
    for name in MATERIAL_MAPS:
        if name in bsdf.values:
            raise SceneError(
                f'{bsdf.where}: {name} is no texture; give <texture type="bitmap" name="{name}">'
            )
        if name not in found and string_value(values, f"{name}_range"):
            raise SceneError(
                f"{bsdf.where}: {name}_range has no effect without {name}; nest that or leave it out"
            )
    extent = _extent(bsdf, values)
    if not found:
        if extent is not None:
            raise SceneError(
                f"{bsdf.where}: map_extent has no effect without a map; nest one or leave it out"
            )
        return material
    if LEVEL_MAP in found and not material.scatters:
        raise SceneError(
            f"{bsdf.where}: {LEVEL_MAP} has no effect without a diffuse return; give a diffuse_law"
        )
    level = classes = None
    if LEVEL_MAP in found:
        bitmap = _bitmap(found[LEVEL_MAP], extent)
        ends = _range(bsdf, values, f"{LEVEL_MAP}_range", "dB")
        if bitmap.placement.attributes not in ((), ("uv",)) and ends is not None:
            bitmap = _fine(bitmap)  # linear in dB within a face
        factor = np.asarray(bitmap.values, dtype=np.float64)
        if ends is not None:
            factor = power_from_db(ends[0] + (ends[1] - ends[0]) * factor)
        level = replace(bitmap, values=factor)
    if PERMITTIVITY_MAP in found or ROUGHNESS_MAP in found:
        classes = _properties(material, bsdf, values, found, extent)
    return replace(material, maps=_make_at_element(bsdf, lambda: SurfaceMaps(level, classes)))


def land_cover(
    name: str, bsdf: Element, values: Mapping[str, Value | None], materials: Callable[[Element], Material]
) -> Material:
    """Material of a ``land_cover`` element: the most frequent one of the map, with the map of all classes.

    Parameters
    ----------
    name : unique in the scene
    bsdf : holds the map and one BSDF for each class, under ``class_N`` for a grey value or ``color_RRGGBB``
    values : its validated parameters
    materials : makes the material of a BSDF

    Raises
    ------
    SceneError : map or classes are missing, or do not match
    """
    where = bsdf.where
    texture = next((child for key, child in bsdf.children if key == CLASS_MAP), None)
    if texture is None:
        raise SceneError(
            f'{where}: land_cover has no map; nest <texture type="bitmap" name="{CLASS_MAP}"> in it'
        )
    nested = {key: child for key, child in bsdf.children if child.kind == "bsdf"}
    codes = {_code(key, where): child for key, child in nested.items()}
    if not codes:
        raise SceneError(
            f'{where}: land_cover names no material; give <ref name="{_NUMBER}1" id="..."/> for the grey value 1, or '
            f'<ref name="{_COLOUR}ff8800" id="..."/>'
        )
    if min(codes) < 0 <= max(codes):
        raise SceneError(
            f"{where}: classes are named by {_NUMBER}N and by {_COLOUR}RRGGBB; name all of them in one way"
        )
    if texture.plugin != "bitmap":
        raise SceneError(f'{texture.where}: a map of classes is a bitmap, not a "{texture.plugin}"')
    _check_texture(texture)
    path = _file(texture)
    pixels = _pixels(path, texture.where)
    if pixels.dtype.kind != "u":
        raise SceneError(
            f"{texture.where}: {path.name} holds no whole numbers; a map of classes is a PNG of 8 bits"
        )
    grey = pixels[..., 0].astype(np.int64)
    colours = pixels.shape[-1] >= 3
    if min(codes) < 0:
        if not colours:
            raise SceneError(
                f"{texture.where}: {path.name} is grey; name its classes {_NUMBER}N, N its values"
            )
        red, green, blue = (pixels[..., i].astype(np.int64) for i in range(3))
        grey = -1 - ((red << 16) | (green << 8) | blue)
    elif colours and (pixels[..., 0:1] != pixels[..., 1:3]).any():
        raise SceneError(f"{texture.where}: {path.name} holds colours; name its classes {_COLOUR}RRGGBB")
    known = np.array(sorted(codes), dtype=np.int64)
    index = np.minimum(np.searchsorted(known, grey), len(known) - 1)
    strange = known[index] != grey
    if strange.any():
        raise SceneError(
            f"{texture.where}: {path.name} holds {_describe_code(int(grey[strange][0]))} "
            f"({int(strange.sum())} pixels without a material); name a material for it"
        )
    parts = tuple(materials(codes[int(code)]) for code in known)
    bitmap = _place_pixels(texture, index.astype(np.int64), _extent(bsdf, values), whole=True)
    classes = _make_at_element(bsdf, lambda: ClassMap(bitmap, parts))
    return replace(classes.most_frequent, name=name, maps=SurfaceMaps(classes=classes))


def _properties(
    material: Material,
    bsdf: Element,
    values: Mapping[str, Value | None],
    found: Mapping[str, Element],
    extent: list[float] | None,
) -> ClassMap:
    """Map of materials made from maps of permittivity and roughness."""
    bitmaps: dict[str, Bitmap] = {}
    numbers: dict[str, F64] = {}
    for name, unit in ((PERMITTIVITY_MAP, ""), (ROUGHNESS_MAP, "m")):
        if name not in found:
            continue
        bitmap = bitmaps[name] = _bitmap(found[name], extent, whole=True)
        ends = _range(bsdf, values, f"{name}_range", unit)
        pixels = np.asarray(bitmap.values, dtype=np.float64)
        numbers[name] = pixels if ends is None else ends[0] + (ends[1] - ends[0]) * pixels
    first, last = bitmaps[min(bitmaps)], bitmaps[max(bitmaps)]
    placement = first.placement
    if first is not last:
        attributes = placement.attributes, last.placement.attributes
        scalar = [names not in ((), ("uv",)) for names in attributes]
        if all(scalar):  # one along u, the other along v
            placement = place_on_mesh((*attributes[0], *attributes[1]))
            numbers[max(bitmaps)] = numbers[max(bitmaps)].T
            shape = ATTRIBUTE_TEXELS, ATTRIBUTE_TEXELS
            numbers = {name: np.broadcast_to(values, shape) for name, values in numbers.items()}
        elif (
            any(scalar)
            or attributes[0] != attributes[1]
            or not np.array_equal(placement.matrix, last.placement.matrix)
        ):
            raise SceneError(
                f"{bsdf.where}: {PERMITTIVITY_MAP} and {ROUGHNESS_MAP} have different placements on the surface; "
                "give both the "
                "same to_uv, or take attributes of the mesh for both"
            )
    number, parts = _make_at_element(
        bsdf, lambda: vary_material(material, numbers.get(PERMITTIVITY_MAP), numbers.get(ROUGHNESS_MAP))
    )
    return ClassMap(replace(first, values=number, placement=placement), parts)


def _bitmap(texture: Element, extent: list[float] | None, *, whole: bool = False) -> Bitmap:
    """Pixels of 0 ... 1 (floating-point files: as stored) and their placement."""
    _check_texture(texture)
    if texture.plugin == "mesh_attribute":
        name = texture.values.get("name")
        if not isinstance(name, str) or not name.startswith(("vertex_", "face_")):
            raise SceneError(
                f"{texture.where}: name = {one_line(name)} is no attribute of a mesh; give vertex_... or face_..."
            )
        if extent is not None:
            raise SceneError(f"{texture.where}: an attribute of the mesh takes no map_extent; leave that out")
        bitmap = Bitmap(np.zeros((1, 2)), place_on_mesh((name,)), smooth=not whole)
        return _fine(bitmap) if whole else _ramp(bitmap, 2)
    path = _file(texture)
    pixels = _pixels(path, texture.where)
    if pixels.shape[-1] >= 3 and (pixels[..., 0:1] != pixels[..., 1:3]).any():
        raise SceneError(f"{texture.where}: {path.name} holds colours; a map of numbers is grey")
    values = pixels[..., 0].astype(np.float64)
    if pixels.dtype.kind == "u":
        values /= float(2 ** (8 * pixels.dtype.itemsize) - 1)
    if not np.isfinite(values).all():
        raise SceneError(f"{texture.where}: {path.name} holds numbers that are not finite; repair it")
    return _place_pixels(texture, values, extent, whole=whole)


def _ramp(bitmap: Bitmap, n: int) -> Bitmap:
    """Row of ``n`` texels for an attribute of 0 ... 1: 0 at the middle of the first texel, 1 at that of the last."""
    ends = np.array([[1.0 - 1.0 / n, 0.0, 0.5 / n], [0.0, 0.0, 0.5]])
    placement = Placement(ends, bitmap.placement.attributes)
    return replace(bitmap, values=np.linspace(0.0, 1.0, n)[None], placement=placement)


def _fine(bitmap: Bitmap) -> Bitmap:
    """Row of texels as `_ramp`, in steps of 1 / 256 of the attribute."""
    if bitmap.smooth:
        return _ramp(bitmap, ATTRIBUTE_TEXELS)
    values = (np.arange(ATTRIBUTE_TEXELS) + 0.5)[None] / ATTRIBUTE_TEXELS
    return replace(bitmap, values=values, placement=place_on_mesh(bitmap.placement.attributes))


def _place_pixels(
    texture: Element,
    values: F64 | I64,
    extent: list[float] | None,
    *,
    whole: bool,
) -> Bitmap:
    """Placement of the pixels; ``whole``: constant within each pixel, not interpolated."""
    given = texture.values
    kind = given.get("filter_type", "nearest" if whole else "bilinear")
    if kind not in (("nearest",) if whole else ("nearest", "bilinear")):
        allowed = "nearest: materials are not interpolated" if whole else "nearest or bilinear"
        raise SceneError(f"{texture.where}: filter_type = {one_line(kind)} is not {allowed}")
    wrap = given.get("wrap_mode", "repeat" if extent is None else "clamp")
    if wrap not in ("repeat", "clamp"):
        raise SceneError(f"{texture.where}: wrap_mode = {one_line(wrap)} is not repeat or clamp")
    matrix = given.get("to_uv")
    transform = None
    if matrix is not None:
        if not isinstance(matrix, np.ndarray) or matrix.shape != (4, 4) or not np.isfinite(matrix).all():
            raise SceneError(f'{texture.where}: to_uv is not a transform; give <transform name="to_uv">')
        transform = matrix[np.ix_([0, 1, 3], [0, 1, 3])]  # as in Mitsuba
    placement = (
        place_on_mesh(("uv",), transform)
        if extent is None
        else _make_at_element(texture, lambda: place_in_plan(extent, transform))
    )
    return Bitmap(values, placement, repeat=wrap == "repeat", smooth=kind == "bilinear")


def _check_texture(texture: Element) -> None:
    """Raise a SceneError for a texture that is no map, or for parameters without effect."""
    known = _TEXTURES.get(texture.plugin)
    if known is None:
        raise SceneError(
            f'{texture.where}: texture type "{texture.plugin}" is no map; use bitmap or mesh_attribute'
        )
    for name in texture.given():
        if name not in known:
            guess = did_you_mean(name, known) or f"; a map knows {', '.join(known)}"
            raise SceneError(f'{texture.where}: unknown parameter "{name}"{guess}')
    if texture.values.get("raw", True) is not True:
        raise SceneError(
            f"{texture.where}: raw = false is for colours; a map holds numbers as they are, leave it out"
        )


def map_file(texture: Element) -> Path | None:
    """Path of a bitmap's file; None for an attribute of the mesh."""
    name = texture.values.get("filename")
    return texture.folder / name if isinstance(name, str) and name else None


def _file(texture: Element) -> Path:
    path = map_file(texture)
    if path is None:
        raise SceneError(f'{texture.where}: no bitmap is named; give <string name="filename" value=.../>')
    if not os.path.isfile(path):
        raise SceneError(
            f'{texture.where}: bitmap "{one_line(path.name)}" not found in {texture.folder}; check filename'
        )
    return path


def _pixels(path: Path, where: str) -> NDArray[np.generic]:
    """Values of a bitmap file as stored, (rows, columns, channels), first row on top."""
    bitmap = mi.Bitmap
    _check_size(path, where)
    try:
        if not _is_exr(
            path
        ):  # that is decoded by threads, which a fork does not copy, in time by its checked size
            survive(path, lambda: bitmap(str(path)))
        pixels = np.array(bitmap(str(path)))
    except DataError as error:
        raise SceneError(f"{where}: bitmap {path.name}: {error}") from None
    except (RuntimeError, ValueError) as error:
        what = one_line(str(error).rpartition(": ")[2] or "unreadable", 100)
        raise SceneError(
            f"{where}: cannot read bitmap {path.name}: {what}; give a PNG, JPEG or OpenEXR file"
        ) from None
    pixels = pixels[..., None] if pixels.ndim == 2 else pixels
    if pixels.ndim != 3 or not pixels.size:
        raise SceneError(f"{where}: bitmap {path.name} holds no pixels")
    return pixels


def _check_size(path: Path, where: str) -> None:
    """Raise a SceneError where a bitmap's header states more pixels than `MOST_PIXELS`, before decoding."""
    from PIL import Image, UnidentifiedImageError

    try:
        size = check_regular(path)
        if _is_exr(path):
            survive(path, lambda: _exr_size(path))
            width, height, unpacked = _exr_size(path)
        else:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", Image.DecompressionBombWarning)
                with Image.open(path) as picture:
                    width, height = picture.size
                    number = 2 if "16" in picture.mode or picture.mode == "I" else 1
                    unpacked = width * height * len(picture.getbands()) * number
    except OSError as error:
        what = "unknown format" if isinstance(error, UnidentifiedImageError) else error.strerror or error
        raise SceneError(
            f"{where}: cannot read bitmap {path.name}: {one_line(what, 100)}; give a PNG, JPEG or OpenEXR file"
        ) from None
    except DataError as error:
        raise SceneError(f"{where}: bitmap {path.name}: {error}") from None
    except Image.DecompressionBombError:
        raise SceneError(
            f"{where}: bitmap {path.name} has more pixels than the bound {MOST_PIXELS}; resample it"
        ) from None
    except (
        RuntimeError,
        ValueError,
        LookupError,
        TypeError,
        SyntaxError,
    ) as error:
        raise SceneError(
            f"{where}: cannot read bitmap {path.name}: {one_line(error, 100)}; give a PNG, JPEG or OpenEXR file"
        ) from None
    if not 0 < width * height <= MOST_PIXELS:
        raise SceneError(
            f"{where}: bitmap {path.name} has {width} x {height} pixels, more than the bound {MOST_PIXELS}; resample it"
        )
    try:
        check_unpacked(unpacked, size)
    except DataError as error:
        raise SceneError(f"{where}: bitmap {path.name}: {error}") from None


def _is_exr(path: Path) -> bool:
    with path.open("rb") as file:
        return file.read(len(_EXR)) == _EXR


def _exr_size(path: Path) -> tuple[int, int, int]:
    """Columns and rows of an OpenEXR file, and unpacked bytes of all channels and parts."""
    import OpenEXR

    sizes, unpacked = [], 0
    for part in OpenEXR.File(str(path), header_only=True).parts:
        low, high = part.header["dataWindow"]
        width, height = (int(b) - int(a) + 1 for a, b in zip(low, high, strict=True))
        sizes.append((width, height))
        unpacked += max(width * height, 0) * _EXR_CHANNEL * len(part.header["channels"])
    return *sizes[0], unpacked


def _code(key: str, where: str) -> int:
    """Number of a class from the name of its BSDF: a grey value, or negative for a colour."""
    try:
        if key.startswith(_COLOUR) and len(key) == len(_COLOUR) + 6:
            return -1 - int(key.removeprefix(_COLOUR), 16)
        if key.startswith(_NUMBER):
            return int(key.removeprefix(_NUMBER))
    except ValueError:
        pass
    raise SceneError(
        f'{where}: "{one_line(key)}" names no class; call it {_NUMBER}N for the grey value N, or {_COLOUR}RRGGBB'
    )


def _describe_code(code: int) -> str:
    return f"{_COLOUR}{-1 - code:06x}" if code < 0 else f"{_NUMBER}{code}"


def _extent(bsdf: Element, values: Mapping[str, Value | None]) -> list[float] | None:
    return _numbers(bsdf, "map_extent", string_value(values, "map_extent"), 4, "x and y of two corners, m")


def _range(bsdf: Element, values: Mapping[str, Value | None], name: str, unit: str) -> list[float] | None:
    what = f"the values at a pixel of 0 and of 1{', ' + unit if unit else ''}"
    return _numbers(bsdf, name, string_value(values, name), 2, what)


def _numbers(bsdf: Element, name: str, text: str, count: int, what: str) -> list[float] | None:
    """Numbers in a text, separated by blanks or commas; None for an empty text."""
    if not text:
        return None
    try:
        numbers = [float(number) for number in text.replace(",", " ").split()]
    except ValueError:
        numbers = []
    if len(numbers) != count or not np.isfinite(numbers).all():
        raise SceneError(f'{bsdf.where}: {name} = "{one_line(text)}" is not {count} numbers; give {what}')
    return numbers


def _make_at_element(element: Element, make: Callable[[], T]) -> T:
    """Result of a function; its errors are raised with the element's place."""
    try:
        return make()
    except SceneError as error:
        raise SceneError(f"{element.where}: {error}") from None
