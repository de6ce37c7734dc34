"""OpenEXR picture of a complex image, for image tools: float32 channels with names.

Row i, column j is the pixel [azimuth i, range j] of the array, so a viewer shows azimuth downwards.
"""

import json
from pathlib import Path

import numpy as np
import OpenEXR
from numpy.typing import NDArray

from sarmitsuba.errors import OutputError
from sarmitsuba.image.sar_image import SarImage
from sarmitsuba.io.atomic import atomic_path
from sarmitsuba.io.encoding import to_json
from sarmitsuba.io.formats import FORMATS, FileFormat


def named_planes(image: SarImage) -> dict[str, NDArray[np.complex64]]:
    """Planes by EXR layer: ``VV``, and ``VV.order1`` ... where bounce orders are kept apart; subsets are added."""
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
        channels[f"{name}.re"] = np.ascontiguousarray(plane.real, dtype=np.float32)
        channels[f"{name}.im"] = np.ascontiguousarray(plane.imag, dtype=np.float32)
    header = {
        "compression": OpenEXR.ZIP_COMPRESSION,
        "type": OpenEXR.scanlineimage,
        "comments": "complex radar image; |re + j im|^2 is the radar cross section in m^2; rows are azimuth",
        "sarmitsuba": json.dumps(_facts(image)),
    }
    with atomic_path(path) as temporary:
        try:
            OpenEXR.File(header, channels).write(str(temporary))
        except RuntimeError as error:  # OpenEXR's own word for a failed write
            raise OutputError(f"{path}: cannot write: {' '.join(str(error).split())}") from error


def _facts(image: SarImage) -> object:
    grid = image.grid
    return to_json(
        {
            "grid": grid.kind,
            "azimuth_start_m": float(grid.azimuth[0]),
            "azimuth_spacing_m": grid.azimuth_spacing,
            "range_start_m": float(grid.range[0]),
            "range_spacing_m": grid.range_spacing,
            "wavelength_m": image.wavelength,
        },
        strict=True,
    )


FORMATS.register(FileFormat("openexr", "complex image for image tools", (".exr",), write_image=write))

__all__ = ["named_planes", "write"]
