"""OpenEXR files of complex images, for image tools: named float32 channels.

Rows are in display order as in the quick-look: flight direction up, range to the right. The first row is the last of
the array; ``row_azimuth_m`` in the header states the azimuth of the rows.
"""

from pathlib import Path

import numpy as np
import OpenEXR

from sarmitsuba.core.arrays import C64
from sarmitsuba.core.errors import OutputError
from sarmitsuba.files.formats import FORMATS, FileFormat
from sarmitsuba.machine.atomic import atomic_path
from sarmitsuba.signal.image import SarImage
from sarmitsuba.version import __version__


def named_planes(image: SarImage) -> dict[str, C64]:
    """Planes by EXR layer: ``VV``, and ``VV.order1`` ... if bounce orders are kept separate; subsets are summed."""
    planes = {channel: image.total(channel) for channel in image.channels}
    for channel in image.channels:
        orders = {layer.order for layer in image.layers if layer.channel == channel and layer.order > 0}
        for order in sorted(orders):
            picks = [i for i, e in enumerate(image.layers) if (e.channel, e.order) == (channel, order)]
            planes[f"{channel}.order{order}"] = image.data[picks].sum(axis=0, dtype=np.complex64)
    return planes


def write(path: Path | str, image: SarImage) -> None:
    """Write every plane as two channels ``<name>.re`` and ``<name>.im``, m (square root of RCS)."""
    channels = {}
    for name, plane in named_planes(image).items():
        up = plane[::-1]
        channels[f"{name}.re"] = np.ascontiguousarray(up.real, dtype=np.float32)
        channels[f"{name}.im"] = np.ascontiguousarray(up.imag, dtype=np.float32)
    header = {
        "compression": OpenEXR.ZIP_COMPRESSION,
        "type": OpenEXR.scanlineimage,
        "comments": "complex radar image; |re + j im|^2 is the radar cross section in m^2",
        **_where(image),
    }
    with atomic_path(path) as temporary:
        try:
            OpenEXR.File(header, channels).write(str(temporary))
        except RuntimeError as error:  # raised by OpenEXR for failed writes
            raise OutputError(f"{path}: cannot write: {' '.join(str(error).split())}") from error


def _where(image: SarImage) -> dict[str, object]:
    """Header with the pixel positions, in the frame of the scene's file; only vectors have double precision in EXR.

    Notes
    -----
    A pixel of row azimuth a and column range r is at ``image_plane_origin_m + a along + g across``, with g = r on a
    ground grid and g = sqrt(r^2 - h^2) on a slant grid, h the height of ``origin_m`` over the plane.
    """
    grid = image.grid.in_frame(np.zeros(3))
    return {
        "software": f"sarmitsuba {__version__}",
        "frame": "the scene file's own: x east, y north, z up, metres",
        "grid": grid.kind,
        "origin_m": grid.origin,
        "image_plane_origin_m": np.array([*grid.origin[:2], grid.height]),
        "anchor": np.array([*np.degrees([grid.anchor.latitude, grid.anchor.longitude]), grid.anchor.height]),
        "along": grid.along,
        "across": grid.across,
        # first row or column, and the step to the next
        "row_azimuth_m": np.array([grid.azimuth[-1], -grid.azimuth_spacing]),
        "column_range_m": np.array([grid.range[0], grid.range_spacing]),
        "wavelength_m": image.wavelength,
        "azimuth_resolution_cell_m": image.azimuth_resolution_cell,
        "range_resolution_cell_m": image.range_resolution_cell,
    }


FORMATS.register(FileFormat("openexr", "complex image for image tools", (".exr",), write_image=write))
