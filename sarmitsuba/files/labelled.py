"""Images and raw data as arrays with named dimensions, units and coordinates, for xarray.

Optional packages of the extra ``formats`` are imported when needed.
"""

import importlib
from types import ModuleType

import numpy as np

from sarmitsuba.core.constants import SPEED_OF_LIGHT
from sarmitsuba.core.errors import DataError
from sarmitsuba.radar.utc import utc_text
from sarmitsuba.signal.image import SarImage
from sarmitsuba.signal.raw_data import RawData


def formats_package(module: str, what: str) -> ModuleType:
    """Import a module of an optional package.

    Parameters
    ----------
    module : dotted name
    what : start of the error message

    Raises
    ------
    DataError
        The package is missing.
    """
    try:
        return importlib.import_module(module)
    except ImportError as error:
        package = module.partition(".")[0]
        raise DataError(
            f"{what} the package {package} ({error}); pip install 'sarmitsuba[formats]'"
        ) from error


def labelled_image(image: SarImage) -> object:
    """See :meth:`sarmitsuba.SarImage.to_xarray`."""
    xarray = formats_package("xarray", "to_xarray needs")
    grid = image.grid.in_frame(np.zeros(3))
    geodetic = image.grid.geodetic()
    across = "slant range" if grid.kind == "slant" else "ground range from the origin"
    return xarray.DataArray(
        np.stack([image.total(channel) for channel in image.channels]),
        dims=("channel", "azimuth", "range"),
        name="image",
        coords={
            "channel": list(image.channels),
            "azimuth": ("azimuth", grid.azimuth, {"units": "m", "long_name": "along the flight"}),
            "range": ("range", grid.range, {"units": "m", "long_name": across}),
            "incidence_angle": ("range", image.incidence_angle, {"units": "rad"}),
            "latitude": (("azimuth", "range"), np.degrees(geodetic[..., 0]), {"units": "degrees_north"}),
            "longitude": (("azimuth", "range"), np.degrees(geodetic[..., 1]), {"units": "degrees_east"}),
        },
        attrs={
            "units": "m",
            "long_name": "root of radar cross section, complex",
            "grid": grid.kind,
            "wavelength_m": image.wavelength,
            "azimuth_resolution_cell_m": image.azimuth_resolution_cell,
            "range_resolution_cell_m": image.range_resolution_cell,
        },
    )


def labelled_raw(raw: RawData) -> object:
    """See :meth:`sarmitsuba.RawData.to_xarray`."""
    xarray = formats_package("xarray", "to_xarray needs")
    radar = raw.radar.in_file_frame()
    samples = np.arange(raw.data.shape[2])
    start = radar.window.start_range
    if raw.domain == "compressed":
        ranges = start[:, None] + radar.window.sample_spacing * samples
        fast = ("slant_range", ranges, {"units": "m", "long_name": "slant range"})
    else:
        first = 2.0 * start / SPEED_OF_LIGHT - 0.5 * radar.waveform.pulse_width
        times = first[:, None] + samples / radar.window.sampling_rate
        fast = ("fast_time", times, {"units": "s", "long_name": "time after transmission"})
    return xarray.DataArray(
        np.stack([raw.total(channel) for channel in raw.channels]),
        dims=("channel", "pulse", "sample"),
        name="echoes",
        coords={
            "channel": list(raw.channels),
            "time": ("pulse", radar.track.time, {"units": "s", "epoch": utc_text(radar.track.epoch)}),
            **{
                f"position_{name}": (
                    "pulse",
                    radar.track.position[:, i],
                    {"units": "m", "long_name": "antenna"},
                )
                for i, name in enumerate(("east", "north", "up"))
            },
            fast[0]: (("pulse", "sample"), *fast[1:]),
        },
        attrs={
            "units": "sqrt(W)",
            "domain": raw.domain,
            "center_frequency_hz": radar.waveform.center_frequency,
            "bandwidth_hz": radar.waveform.bandwidth,
        },
    )
