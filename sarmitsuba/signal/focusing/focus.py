"""Focusing of raw data into a calibrated complex image."""

import warnings
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np

from sarmitsuba.core.constants import DEFAULT_WINDOW
from sarmitsuba.core.errors import SarmitsubaWarning
from sarmitsuba.core.progress import Progress, silent
from sarmitsuba.core.units import db_from_power, power_from_db
from sarmitsuba.machine.exclusive import exclusive
from sarmitsuba.radar.collection import signal_facts
from sarmitsuba.radar.flight import flight_facts
from sarmitsuba.radar.image_request import ImageRequest
from sarmitsuba.radar.radar import Radar
from sarmitsuba.signal.focusing.aperture_weights import flight, incidence_angle
from sarmitsuba.signal.focusing.autofocus import Autofocuser, AutofocusTask, remove_error
from sarmitsuba.signal.focusing.beam_edge import beam_edge_warning
from sarmitsuba.signal.focusing.cells import azimuth_cells
from sarmitsuba.signal.focusing.focuser import DEFAULT, Focused, Focuser, FocusTask
from sarmitsuba.signal.focusing.image_noise import noise_equivalent_sigma0
from sarmitsuba.signal.focusing.motion_compensation import compensate_motion
from sarmitsuba.signal.focusing.preparation import prepare, raw_data
from sarmitsuba.signal.focusing.shown import shown_share
from sarmitsuba.signal.focusing.windows import Window
from sarmitsuba.signal.focusing.witness import conjugation_warning, witness_focusing, witness_warning
from sarmitsuba.signal.image.sar_image import ImageGrid, SarImage
from sarmitsuba.signal.raw.raw_data import Layer, RawData

# deviation from 1 of the footprint's speed over the antenna's up to which a beam counts as fixed to the track: rounding
_FIXED = 1e-9


@exclusive
def focus(
    raw: RawData | Path | str,
    grid: ImageGrid | None = None,
    *,
    request: ImageRequest | Mapping[str, object] | None = None,
    focuser: str | Focuser = DEFAULT,
    range_window: str | Window = DEFAULT_WINDOW,
    azimuth_window: str | Window = DEFAULT_WINDOW,
    compression: Literal["flat", "matched"] = "flat",
    motion_compensation: str = "auto",
    autofocus: str | Autofocuser | None = None,
    progress: Progress = silent,
) -> SarImage:
    """Focus raw data into a calibrated image, layer by layer.

    Parameters
    ----------
    raw : chirped (compressed here first) or range-compressed data, or the file of such data
    grid : pixels; default: :func:`default_grid` of ``request``, or of the data's own request
    request : image request for the default grid, or a mapping with changes of the data's own, such as
        ``{"grid": "ground", "extent_range": 40.0, "spacing_range": 0.1, "height": 3.0}``
    focuser : name in ``FOCUSERS`` (``backprojection``: any track and grid; ``omega_k``, ``range_doppler``,
        ``chirp_scaling``: straight, level, uniform track, a grid along it), with options if wanted, such as
        ``backprojection,interpolation=kernel:8``; ``auto``, the default, is backprojection, for large images in its
        factorised form if that errs by 20 dB less than the data, and ``auto,error=-50`` the cheapest of all with that
        error; or a focuser itself
    range_window, azimuth_window : ``taylor`` (default), ``rectangular`` (none), ``hamming``, ``taylor:4:-35``, ... (see
        ``WINDOWS``); over the bandwidth and over the pulse index
    compression : of chirped data, see :func:`sarmitsuba.signal.focusing.range_compression.compression_filter`
    motion_compensation : ``auto`` compensates the recorded track to a straight one where the focuser needs one, see
        :mod:`sarmitsuba.signal.focusing.motion_compensation`; ``off``: such a focuser refuses the data
    autofocus : name in ``AUTOFOCUSERS`` (``phase_gradient``, ``minimum_entropy``, ``maximum_contrast``), with options
        if wanted, such as ``phase_gradient,rounds=12``; or an autofocuser itself; None and ``none``: the recorded track
    progress : called after every batch

    Returns
    -------
    SarImage : ``abs(pixel)**2`` is the RCS at a point's peak; ``sigma0`` refers to flat ground

    Raises
    ------
    ExtensionError
        There is no such focuser or autofocuser.
    DataError
        Unknown window, data or a grid that the focuser refuses, or echoes that are NaN or infinite.
    ResourceError
        The image does not fit into memory.
    """
    raw = raw_data(raw)
    windows = (range_window, azimuth_window)
    chain = prepare(raw, grid, request, focuser, windows, compression, motion_compensation, autofocus)
    raw, echoes, grid, focuser = chain.raw, chain.raw, chain.grid, chain.focuser
    range_window, azimuth_window = chain.windows
    corrections: dict[str, object] = {}
    left_db = -np.inf
    if chain.compensation is not None:
        plan, residual = chain.compensation
        raw = compensate_motion(raw, plan)
        left_db = residual.error_db
        corrections["motion_compensation"] = {
            "largest_displacement": plan.largest_displacement,
            "residual_phase": residual.phase,
        }
    if chain.autofocus is not None:
        one = replace(raw, data=raw.total()[None], layers=(Layer(raw.channels[0]),))
        task = AutofocusTask(one, grid, focuser, range_window, azimuth_window, progress)
        raw, corrections["autofocus"] = remove_error(raw, chain.autofocus, task)
    focused = focuser.focus(FocusTask(raw, grid, range_window, azimuth_window, progress))
    law_db = _sum_db(focuser.error_db(raw.radar, grid), left_db)
    # of the track as recorded, whatever it was straightened to; an error that autofocus took out is in no record
    measured = raw if chain.autofocus is not None else echoes
    witness = witness_focusing(measured, focused.pixels, grid, focuser, chain.windows, law_db)
    if witness is not None and chain.autofocus is not None:
        witness = replace(
            witness, reference=f"{witness.reference} of the data after {' and '.join(corrections)}"
        )
    if chain.halfway != 0.0:
        focused.pixels[...] *= np.complex64(np.exp(1j * chain.halfway))

    middle = grid.positions_on_line(grid.azimuth.size // 2)
    incidence = incidence_angle(raw.radar, middle)
    range_cell = raw.radar.waveform.range_cell * range_window.broadening
    cells = azimuth_cells(raw.radar, grid, focused.pulse_weights, range_window)
    for text in (
        cells.warning,
        beam_edge_warning(raw.radar, grid, azimuth_window, cells.center),
        "" if witness is None else witness_warning(witness, focuser),
        conjugation_warning(raw, focused.pixels, grid, chain.windows),
    ):
        if text:
            warnings.warn(f"focus: {text}", SarmitsubaWarning, stacklevel=2)
    stated = law_db
    if witness is not None:
        stated = witness.upper_db if measured is echoes else _sum_db(witness.upper_db, left_db)
    facts = {
        "method": focuser.name,
        "stated_error_db": round(stated, 1) if np.isfinite(stated) else None,
        **({} if witness is None else {"witness": witness.as_dict()}),
        **({"chosen": chain.chosen} if chain.chosen else {}),
        "range_window": str(range_window),
        "azimuth_window": str(azimuth_window),
        **focuser.options,
        **cells.facts,
        **corrections,
        "center_position": [float(v) for v in raw.radar.track.center_position + raw.radar.offset],
        **flight_facts(raw.radar),
        **signal_facts(raw.radar),
        "range_compression": raw.metadata.get("range_compression", "none"),
        **_of_the_radar(raw.radar, grid, focused, range_window),
    }
    sine = float(np.sin(incidence[incidence.size // 2]))
    share = shown_share(echoes, focused.pixels, grid, (cells.center, range_cell), sine)
    if share > 0.0:
        facts["shown_energy_db"] = round(10.0 * float(np.log10(share)), 1)
    return SarImage(
        data=focused.pixels,
        layers=raw.layers,
        grid=grid,
        wavelength=raw.radar.waveform.wavelength,
        azimuth_resolution_cell=cells.center,
        range_resolution_cell=range_cell,
        incidence_angle=incidence,
        metadata={**raw.metadata, "focus": facts},
    )


def _sum_db(first: float, second: float) -> float:
    """Sum of two energies, dB."""
    return float(db_from_power(power_from_db(first) + power_from_db(second)))


def _of_the_radar(
    radar: Radar, grid: ImageGrid, focused: Focused, range_window: Window
) -> dict[str, float | bool]:
    """Reference figures for quality measures: squint of pixels with their own apertures, and NESZ at the centre."""
    facts: dict[str, float | bool] = {}
    middle = radar.track.center_index
    if radar.mode_law.own_apertures and (np.isfinite(radar.half_aperture) or radar.antenna.directive):
        forward, sine, _ = flight(radar)
        facts["squint_sine"] = float(sine[middle])
        speed = radar.footprint_speed
        if abs(1.0 - speed) > _FIXED:
            line = radar.aim_point - radar.track.center_position
            closest = float(np.linalg.norm(line - (line @ forward[middle]) * forward[middle]))
            facts["turning_range"] = closest / (1.0 - speed)
    if radar.all_round:
        facts["all_round"] = True
    if radar.noise_temperature > 0.0:
        point = grid.positions_on_line(grid.azimuth.size // 2)[grid.range.size // 2]
        facts["nesz"] = noise_equivalent_sigma0(radar, point, focused.pulse_weights(point), range_window)
    return facts
