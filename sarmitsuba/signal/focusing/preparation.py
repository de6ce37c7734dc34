"""Steps before focusing that focusing and its linear operator share: compression, grid, choice of the focuser."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from sarmitsuba.core.errors import DataError
from sarmitsuba.core.finite import check_pulses
from sarmitsuba.core.registry import late
from sarmitsuba.radar.image_request import ImageRequest
from sarmitsuba.radar.radar import Radar
from sarmitsuba.radar.validity import check_radar
from sarmitsuba.signal.focusing.autofocus import Autofocuser, parse_autofocus
from sarmitsuba.signal.focusing.data_error import data_error_db
from sarmitsuba.signal.focusing.focuser import Focuser, parse_focuser
from sarmitsuba.signal.focusing.grid import default_grid
from sarmitsuba.signal.focusing.memory_needs import check_image_fits
from sarmitsuba.signal.focusing.motion_compensation import Residual, Straightening, needs_compensation
from sarmitsuba.signal.focusing.range_compression import Compression, range_compress
from sarmitsuba.signal.focusing.windows import Window, parse_window
from sarmitsuba.signal.image.pixel_bounds import check_grid
from sarmitsuba.signal.image.sar_image import ImageGrid
from sarmitsuba.signal.raw.pulse_motion import standing_still
from sarmitsuba.signal.raw.raw_data import RawData


@dataclass(frozen=True, eq=False)
class Preparation:
    """Data ready for a focuser, and how they are to be focused.

    Parameters
    ----------
    raw : range compressed, in the start-stop approximation, before motion compensation
    grid : pixels
    focuser, chosen : the one used, and why, where it was chosen
    windows : over the bandwidth and over the pulses
    compensation : motion compensation that the focuser needs, with its residual; None where it needs none
    autofocus : estimates the track's errors from the data; None: the recorded track
    halfway : rad, phase of the start-stop approximation by which pixels are multiplied
    """

    raw: RawData
    grid: ImageGrid
    focuser: Focuser
    chosen: str
    windows: tuple[Window, Window]
    compensation: tuple[Straightening, Residual] | None
    autofocus: Autofocuser | None
    halfway: float


def raw_data(given: RawData | Path | str) -> RawData:
    """Raw data as they are, or those of a file.

    Raises
    ------
    DataError : neither, or a file that holds none
    """
    if isinstance(given, Path | str):
        raw: RawData = late("sarmitsuba.files", "read_raw")(given)  # type: ignore[assignment]
        return raw
    if not isinstance(given, RawData):
        raise DataError(
            f"focus: {type(given).__name__} is no raw data; give those of simulate or read_raw, or a file of them, "
            "such as raw.h5"
        )
    return given


def prepare(
    raw: RawData,
    grid: ImageGrid | None,
    request: ImageRequest | Mapping[str, object] | None,
    focuser: str | Focuser,
    windows: tuple[str | Window, str | Window],
    compression: Compression,
    motion_compensation: str,
    autofocus: str | Autofocuser | None,
) -> Preparation:
    """Range compression, grid and choice of the focuser; parameters and errors as of :func:`sarmitsuba.focus`."""
    check_radar(raw.radar)
    if grid is not None:
        check_grid(grid)
    focuser = parse_focuser(focuser)
    parsed = (parse_window(windows[0]), parse_window(windows[1]))
    check_pulses(raw.data, "focus: ")
    raw = replace(range_compress(raw, method=compression), autofocus_records={})
    halfway = start_stop_phase(raw.radar)
    raw = standing_still(raw)
    if grid is None:
        grid = default_grid(raw, request)
    grid = replace(grid.in_frame(raw.radar.offset), anchor=raw.anchor)
    method = parse_autofocus(autofocus)
    if method is not None and raw.radar.receiver is not None:
        raise DataError("autofocus: not possible with bistatic data; leave it out")
    compensation = needs_compensation(focuser, raw.radar, grid, motion_compensation)
    focuser, chosen = focuser.resolved(raw.radar, grid, partial(data_error_db, raw))
    n_layers = len(raw.layers)
    check_image_fits(grid, n_layers, focuser.making_bytes(raw.radar, grid, n_layers))
    return Preparation(raw, grid, focuser, chosen, parsed, compensation, method, halfway)


def start_stop_phase(radar: Radar) -> float:
    r"""Phase delay (rad) of an echo of the aim point against that of `Radar.start_stop`, at mid-aperture.

    :math:`\frac{4 \pi}{\lambda} b^2 \cos^2\psi / 8 R` for a path b of the antenna between transmission and reception:
    0.1 rad in X band from orbit, and the same for all pixels.
    """
    if not radar.receives_itself:
        return 0.0
    i = radar.track.center_index
    excess = radar.slant_range(radar.aim_point)[i] - radar.start_stop().slant_range(radar.aim_point)[i]
    return float(4.0 * np.pi / radar.waveform.wavelength * excess)
