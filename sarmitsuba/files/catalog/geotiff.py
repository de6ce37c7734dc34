"""Cloud-optimised GeoTIFF: magnitude of an image on a map; see docs/files.md."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sarmitsuba.files.formats import FORMATS, FileFormat
from sarmitsuba.files.geocoding import MapGrid, NorthUp, north_up, warn_unplaced
from sarmitsuba.files.labelled import formats_package
from sarmitsuba.machine.atomic import atomic_path
from sarmitsuba.signal.image import SarImage
from sarmitsuba.signal.pixel_labels import Labels
from sarmitsuba.version import __version__


def write_image(path: Path, image: SarImage) -> None:
    """Write the square root of sigma0, one band per channel, on the UTM zone, with overviews; near the poles UPS.

    Warns
    -----
    SarmitsubaWarning
        The scene has no place on the Earth.

    Raises
    ------
    DataError
        rasterio is missing.
    """
    formats_package("rasterio", f"{path}: GeoTIFF files need")
    warn_unplaced(image.anchor)
    on_map = north_up(image)
    tags = {
        "quantity": "square root of sigma0" + ("" if image.calibrated else ", uncalibrated: up to a factor"),
        "wavelength_m": image.wavelength,
    }
    _write(path, on_map.magnitude, on_map, image.channels, float("nan"), "average", tags)


def write_layer(path: Path, labels: Labels, name: str) -> None:
    """Write a layer of labels, one band per part, on the map as images: the nearest pixel.

    Codes are integers as they are, others float32; 255 or the type's largest is outside the image, of others NaN.

    Raises
    ------
    DataError
        rasterio is missing.
    """
    formats_package("rasterio", f"{path}: GeoTIFF files need")
    on, layer = MapGrid.of(labels.grid), labels.layers[name]
    values = np.atleast_3d(layer.values)
    if values.dtype.kind == "f":
        values, nodata = values.astype(np.float32), float("nan")
    else:
        nodata = int(np.iinfo(values.dtype).max)
    row, column = np.rint(on.row).astype(np.int64), np.rint(on.column).astype(np.int64)
    inside = (row >= 0) & (row < values.shape[0]) & (column >= 0) & (column < values.shape[1])
    bands = np.full((values.shape[2], *row.shape), nodata, dtype=values.dtype)
    bands[:, inside] = values[row[inside], column[inside]].T
    tags = {"quantity": layer.description, "unit": layer.unit or "1"} | {
        f"code_{code}": text for code, text in layer.codes.items()
    }
    _write(path, bands, on, layer.parts or (name,), nodata, "nearest", tags)


def _write(
    path: Path,
    bands: NDArray[np.generic],
    place: NorthUp | MapGrid,
    names: Sequence[str],
    nodata: float,
    overviews: str,
    tags: Mapping[str, object],
) -> None:
    """Write bands (n, rows, columns) of a map."""
    rasterio = formats_package("rasterio", f"{path}: GeoTIFF files need")
    profile = {
        "driver": "COG",
        "dtype": str(bands.dtype),
        "count": bands.shape[0],
        "height": bands.shape[1],
        "width": bands.shape[2],
        "crs": f"EPSG:{place.zone}",
        "transform": rasterio.transform.from_origin(place.west, place.north, place.spacing, place.spacing),
        "nodata": nodata,
        "compress": "deflate",
        "overview_resampling": overviews,
    }
    with atomic_path(path) as temporary, rasterio.open(temporary, "w", **profile) as file:
        file.write(bands)
        file.update_tags(software=f"sarmitsuba {__version__}", **tags)
        for band, name in enumerate(names, 1):
            file.set_band_description(band, name)


FORMATS.register(
    FileFormat(
        name="geotiff",
        doc="cloud-optimised GeoTIFF of the magnitude on a map, for GIS (extra: formats)",
        suffixes=(".tif", ".tiff"),
        write_image=write_image,
    )
)
