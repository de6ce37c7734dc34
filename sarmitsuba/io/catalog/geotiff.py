"""Cloud-optimised GeoTIFF: magnitude of an image on a map; see docs/files.md."""

from pathlib import Path

from sarmitsuba.image.sar_image import SarImage
from sarmitsuba.io.atomic import atomic_path
from sarmitsuba.io.extras import formats_package
from sarmitsuba.io.formats import FORMATS, FileFormat
from sarmitsuba.io.geocoding import north_up
from sarmitsuba.version import __version__


def write_image(path: Path, image: SarImage) -> None:
    """Write the square root of sigma0, one band per channel, north up in the UTM zone, with overviews.

    Raises
    ------
    DataError
        rasterio is missing.
    """
    rasterio = formats_package("rasterio", f"{path}: GeoTIFF files need")
    on_map = north_up(image)
    bands, height, width = on_map.magnitude.shape
    profile = {
        "driver": "COG",
        "dtype": "float32",
        "count": bands,
        "height": height,
        "width": width,
        "crs": f"EPSG:{on_map.zone}",
        "transform": rasterio.transform.from_origin(
            on_map.west, on_map.north, on_map.spacing, on_map.spacing
        ),
        "nodata": float("nan"),
        "compress": "deflate",
        "overview_resampling": "average",
    }
    with atomic_path(path) as temporary, rasterio.open(temporary, "w", **profile) as file:
        file.write(on_map.magnitude)
        file.update_tags(
            quantity="square root of sigma0" + ("" if image.calibrated else ", uncalibrated: up to a factor"),
            software=f"sarmitsuba {__version__}",
            wavelength_m=image.wavelength,
        )
        for band, channel in enumerate(image.channels, 1):
            file.set_band_description(band, channel)


FORMATS.register(
    FileFormat(
        name="geotiff",
        doc="cloud-optimised GeoTIFF of the magnitude on a map, for GIS (extra: formats)",
        suffixes=(".tif", ".tiff"),
        write_image=write_image,
    )
)
