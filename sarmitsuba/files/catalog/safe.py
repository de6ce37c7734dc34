"""Level-1 SLC products in the format of Sentinel-1 (SAFE): bursts of a turning beam, or stripmap; see docs/files.md."""

import zipfile
from pathlib import Path

import numpy as np

from sarmitsuba.core.errors import DataError
from sarmitsuba.files import safe_document
from sarmitsuba.files.burst_lines import BurstMap
from sarmitsuba.files.formats import FORMATS, FileFormat
from sarmitsuba.files.labelled import formats_package
from sarmitsuba.files.safe_document import Product
from sarmitsuba.machine.atomic import atomic_path, make_folder
from sarmitsuba.radar.collection import Collection, flight_facts, signal_facts
from sarmitsuba.radar.radar import Radar
from sarmitsuba.signal.image import SarImage

# largest digital number of a product
_LARGEST = 30000.0
_PAIRS = {("VV",): "SV", ("HH",): "SH", ("VV", "VH"): "DV", ("HH", "HV"): "DH"}
_MODES = ("tops", "stripmap")


def write_image(path: Path, image: SarImage) -> None:
    """Write a product: into a folder where the path ends with ``.safe``, else into a ZIP archive of one.

    Digital numbers are the square root of beta0 times a scale, which the calibration states; bursts have the lines of
    their whole length, zero outside of the image.

    Raises
    ------
    DataError
        The image is not in slant range from orbit, its mode or channels are none of Sentinel-1, or rasterio is missing.
    """
    formats_package("rasterio", f"{path}: GeoTIFF files of a SAFE product need")
    collection = Collection.read(image.metadata.get("focus", {}), str(path))
    against = _objection(collection.signal.mode, image.grid.kind, image.channels)
    if against:
        raise DataError(f"{path}: {against}")
    maps = tuple(BurstMap.of(part, str(path)) for part in image.parts or (image,))
    lattice = maps[0].lattice()
    files: list[tuple[str, str, str, bytes]] = []
    products = []
    for number, channel in enumerate(_ordered(image.channels), 1):
        lines = np.concatenate([one.resample(channel, lattice) for one in maps])
        largest = float(max(np.abs(lines.real).max(), np.abs(lines.imag).max()))
        scale = _LARGEST / largest if largest > 0.0 else 1.0
        product = Product(maps, lattice, scale, channel, number)
        products.append(product)
        files += _files_of(product, lines * scale)
    documents = [(where, content) for _, _, where, content in files]
    documents.append(("manifest.safe", safe_document.write(safe_document.manifest(products, files))))
    if path.suffix.lower() == ".safe":
        for where, content in documents:
            make_folder((path / where).parent)
            with atomic_path(path / where) as temporary:
                temporary.write_bytes(content)
        return
    kind = _PAIRS[_ordered(image.channels)]
    start, stop = (products[0].identity.split("-")[i].upper() for i in (0, 1))
    name = f"S1A_{products[0].mode}_SLC__1S{kind}_{start}_{stop}_000001_000001_0001.SAFE"
    with atomic_path(path) as temporary, zipfile.ZipFile(temporary, "w", zipfile.ZIP_DEFLATED) as archive:
        for where, content in documents:
            archive.writestr(zipfile.ZipInfo(f"{name}/{where}"), content, zipfile.ZIP_DEFLATED)


def _ordered(channels: tuple[str, ...]) -> tuple[str, ...]:
    """Channels with the co-polar one first."""
    return tuple(sorted(channels, key=lambda channel: channel[0] != channel[1]))


def _objection(mode: str, kind: str, channels: tuple[str, ...]) -> str:
    if kind != "slant":
        return "SAFE products of level 1 SLC are in slant range; set image_grid = slant in the range_film"
    if mode not in _MODES:
        return f"Sentinel-1 has no mode = {mode}; SAFE products are of {' or '.join(_MODES)}"
    if _ordered(channels) not in _PAIRS:
        return f"Sentinel-1 has no products of {', '.join(channels)}; take {' or '.join(','.join(p) for p in _PAIRS)}"
    return ""


def objection(radar: Radar, kind: str) -> str:
    """Reason why an image on a kind of grid cannot be written, for checks before a run; empty where it can."""
    flight = Collection.read({**signal_facts(radar), **flight_facts(radar)}, "the radar")
    found = _objection(flight.signal.mode, kind, radar.channels)
    height = float(radar.anchor.to_geodetic(flight.flight.center)[2])
    return found or ("" if height > 1e5 else f"the antenna flies {height:.4g} m high, which is no orbit")


def _files_of(product: Product, lines: np.ndarray) -> list[tuple[str, str, str, bytes]]:
    """Documents and pixels of one polarisation: identifier, kind, path, content."""
    stem = product.file_stem
    plain = stem.replace("-", "")
    return [
        (
            f"product{plain}",
            "s1Level1ProductSchema",
            f"annotation/{stem}.xml",
            safe_document.write(product.annotation()),
        ),
        (
            f"noise{plain}",
            "s1Level1NoiseSchema",
            f"annotation/calibration/noise-{stem}.xml",
            safe_document.write(product.noise()),
        ),
        (
            f"calibration{plain}",
            "s1Level1CalibrationSchema",
            f"annotation/calibration/calibration-{stem}.xml",
            safe_document.write(product.calibration()),
        ),
        (plain, "s1Level1MeasurementSchema", f"measurement/{stem}.tiff", _tiff(product, lines)),
    ]


def _tiff(product: Product, lines: np.ndarray) -> bytes:
    """GeoTIFF of complex 16-bit integers with ground control points."""
    rasterio = formats_package("rasterio", "GeoTIFF files need")

    points = [
        rasterio.control.GroundControlPoint(line, sample, float(place[1]), float(place[0]), float(place[2]))
        for line, sample, _, _, place in product.grid_points()
    ]
    whole = (np.rint(lines.real) + 1j * np.rint(lines.imag)).astype(np.complex64)
    with rasterio.MemoryFile() as memory:
        with memory.open(
            driver="GTiff",
            dtype="complex_int16",
            count=1,
            height=lines.shape[0],
            width=lines.shape[1],
            gcps=points,
            crs="EPSG:4326",
        ) as file:
            file.write(whole[None])
        return bytes(memory.read())


FORMATS.register(
    FileFormat(
        name="safe",
        doc="Sentinel-1 level-1 SLC product (SAFE), zipped: of tops or stripmap from orbit (extra: formats)",
        suffixes=(".zip", ".safe"),
        write_image=write_image,
        objection=objection,
    )
)
