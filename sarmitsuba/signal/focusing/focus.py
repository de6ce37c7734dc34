"""Focusing of raw data into a calibrated complex image.

Compression, grid and choice of the focuser are shared with focusing as a linear operator. The image states the error
of simulated echoes, which is known before, and the share of the echoes' energy that it shows. At the edge of a steered
beam, rows in which side lobes of brighter ground exceed the local clutter are found.
"""

import math
import warnings
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Literal

import numpy as np

from sarmitsuba.core.arrays import C64, F64, check_pulses, sum_energy
from sarmitsuba.core.constants import DEFAULT_WINDOW, SUBSET_SHARES
from sarmitsuba.core.errors import DataError, SarmitsubaWarning
from sarmitsuba.core.progress import Progress, silent
from sarmitsuba.core.registry import late
from sarmitsuba.core.units import db_from_power, power_from_db
from sarmitsuba.core.witness import Witness
from sarmitsuba.machine.exclusive import exclusive
from sarmitsuba.radar.collection import flight_facts, signal_facts
from sarmitsuba.radar.image_request import ImageRequest
from sarmitsuba.radar.radar import Radar
from sarmitsuba.radar.validity import check_radar
from sarmitsuba.signal.focusing.aperture_weights import (
    antennas_gain,
    aperture_weights,
    flight,
    incidence_angle,
    matched_weights,
)
from sarmitsuba.signal.focusing.autofocus import Autofocuser, AutofocusTask, parse_autofocus, remove_error
from sarmitsuba.signal.focusing.cells import azimuth_cells
from sarmitsuba.signal.focusing.focuser import (
    DEFAULT,
    EXACT,
    Focused,
    Focuser,
    FocusTask,
    check_image_fits,
    parse_focuser,
)
from sarmitsuba.signal.focusing.frequency_domain.turning import turns
from sarmitsuba.signal.focusing.grid import default_grid
from sarmitsuba.signal.focusing.interference_filter import (
    InterferenceFilter,
    filter_interference,
    parse_interference_filter,
)
from sarmitsuba.signal.focusing.motion_compensation import (
    Residual,
    Straightening,
    compensate_motion,
    needs_compensation,
)
from sarmitsuba.signal.focusing.range_compression import Compression, range_compress
from sarmitsuba.signal.focusing.summed_weights import noise_equivalent_sigma0
from sarmitsuba.signal.focusing.windows import Window, parse_window
from sarmitsuba.signal.focusing.witness import conjugation_warning, witness_focusing, witness_warning
from sarmitsuba.signal.image import ImageGrid, SarImage, check_grid
from sarmitsuba.signal.pulse_motion import standing_still
from sarmitsuba.signal.raw_data import Layer, RawData, sum_of_channel

# pulses at a time
_PULSES = 64


def data_error_db(raw: RawData) -> float:
    r"""Measured error of echoes relative to their energy, dB: NaN where none is known, -inf where there is none.

    The sum of the errors measured before focusing: blocks of pulses, and ray sampling by the difference of two ray
    subsets, in the worst channel,

    .. math:: \epsilon^2 = \frac{1}{4} \sum |x_1 - x_2|^2 / \sum |w_1 x_1 + w_2 x_2|^2

    Ideal points alone, of which nothing is traced, have no error.

    Notes
    -----
    Ignores the errors of which only bounds are known, so that the true one is larger.
    """
    blocks = _number(_part(raw.metadata, "sampling"), "block_error_db")
    rays = _subsets_db(raw)
    known = [power_from_db(error) for error in (blocks, rays) if not math.isnan(error)]
    if known:
        return db_from_power(max(sum(known), 1e-60))
    return -math.inf if _number(_part(raw.metadata, "statistics"), "rays") == 0.0 else math.nan


def _subsets_db(raw: RawData) -> float:
    """Error of ray sampling, dB, in the worst channel; NaN where subsets were not kept."""
    errors = []
    for channel in raw.channels:
        picks = [
            [i for i, la in enumerate(raw.layers) if la.channel == channel and la.subset == subset]
            for subset in (1, 2)
        ]
        if not all(picks):
            return math.nan
        apart = energy = 0.0
        for start in range(0, raw.data.shape[1], _PULSES):
            some = raw.data[:, start : start + _PULSES]
            first, second = (some[i].sum(axis=0, dtype=np.complex64) for i in picks)
            energy += sum_energy(first + second)
            apart += sum_energy(first / (2.0 * SUBSET_SHARES[1]) - second / (2.0 * SUBSET_SHARES[2]))
        if energy > 0.0:
            errors.append(db_from_power(max(apart / energy, 1e-60)))
    return max(errors, default=math.nan)


def _part(metadata: Mapping[str, object], name: str) -> Mapping[str, object]:
    found = metadata.get(name)
    return found if isinstance(found, Mapping) else {}


def _number(facts: Mapping[str, object], name: str) -> float:
    value = facts.get(name)
    return float(value) if isinstance(value, int | float) and not isinstance(value, bool) else math.nan


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


# largest number of pulses and rows from which energies are computed
ROWS = 512


def shown_share(
    raw: RawData,
    pixels: C64,
    grid: ImageGrid,
    cell: tuple[float, float],
    sine: float,
) -> float:
    r"""Share of the echoes' energy that an image contains.

    An ideal point at the middle of the image has in the echoes and in the image the energies

    .. math:: \frac{\delta_r}{\Delta r} \sum_t \left(\frac{K g_t}{R_t R_r}\right)^2, \quad
              \frac{\rho_a \rho_r}{\Delta_a \Delta_r \sin\theta}

    with range cell and sample spacing of the echoes, resolution cells and pixel spacings of the image; on a slant grid
    without the sine. Their quotient turns energies of echoes into energies of images.

    Parameters
    ----------
    raw : range-compressed
    pixels : (n_layers, n_azimuth, n_range) of its image
    grid : of the image
    cell : resolution cells in azimuth and slant range, m
    sine : of the incidence angle at the middle of the image

    Returns
    -------
    the least of all channels; NaN where there is no energy, or noise in the echoes

    Notes
    -----
    Ignores that gain and range differ over the image.
    """
    radar = raw.radar
    if radar.noise_temperature > 0.0 or radar.received:
        return float("nan")
    window = radar.window
    spacing = grid.azimuth_spacing * grid.range_spacing * (sine if grid.kind == "ground" else 1.0)
    middle = grid.positions_on_line(grid.azimuth.size // 2)[grid.range.size // 2]
    echo = float(np.sum(_amplitude(radar, middle) ** 2)) * radar.waveform.range_cell / window.sample_spacing
    image = cell[0] * cell[1] / spacing
    shares = []
    for channel in raw.channels:
        seen = _channel_energy(pixels, raw, channel)
        sent = _channel_energy(raw.data, raw, channel)
        if sent > 0.0 and echo > 0.0:
            shares.append(seen / image / (sent / echo))
    return min(shares, default=float("nan"))


def _amplitude(radar: Radar, place: F64) -> F64:
    """Amplitude of the echoes of a point of 1 m^2 in all pulses, (n_pulses,) sqrt(W)."""
    legs = [place - track.position for track in radar.tracks]
    ranges = [np.linalg.norm(leg, axis=1) for leg in legs]
    directions = [leg / distance[:, None] for leg, distance in zip(legs, ranges, strict=True)]
    gain = antennas_gain(radar, slice(None), directions)
    return np.asarray(radar.amplitude_constant * gain / (ranges[0] * ranges[-1]))


def _channel_energy(data: C64, raw: RawData, channel: str) -> float:
    """Energy of a channel of (n_layers, n_rows, n), from a subset of the rows where there are many."""
    step = -(-data.shape[1] // ROWS)
    some = sum_of_channel(data[:, ::step], raw.layers, channel, "raw data")
    return float(np.vdot(some, some).real * data.shape[1] / some.shape[0])


# rows at which the beam is evaluated, over three times the image's extent
_NODES = 385
# azimuth cells of side lobes that are included, and samples per cell
_LOBES, _FINE = 512, 9
# level error above which rows are named in a warning, dB
_FALSE_LEVEL_DB = 0.2


def false_level(radar: Radar, grid: ImageGrid, window: Window, cell: float) -> F64:
    r"""Level error of homogeneous clutter in every row, linear ratio to the truth, (n_azimuth,) float64.

    Focusing divides by the beam's gain, which also raises the side lobes of other rows:

    .. math:: l(x) = \frac{\sum_m P(x + m \delta) |h_m|^2}{P(x) \sum_m |h_m|^2}

    Parameters
    ----------
    radar, grid : beam and image
    window : over the aperture; its transform is h
    cell : m, noise-equivalent azimuth cell

    Notes
    -----
    P is the mean two-way power gain over the pixel's aperture at the image's middle column. Ignores azimuth
    ambiguities and the gain's change over the aperture.
    """
    middle = grid.positions_on_line(grid.azimuth.size // 2)[grid.range.size // 2]
    half = max(1.5 * float(np.ptp(grid.azimuth)), cell)
    center = float(grid.azimuth[grid.azimuth.size // 2])
    node = np.linspace(-half, half, _NODES)
    power = np.empty(_NODES)
    for i, x in enumerate(node):
        point = middle + x * grid.along
        weights = aperture_weights(radar, point, window)
        power[i] = matched_weights(radar, point, window).sum() / max(float(weights.sum()), 1e-300)
    power = np.maximum(power, 1e-12)

    n = 2 * _LOBES
    response = np.abs(np.fft.fft(window((np.arange(n) + 0.5) / n - 0.5), n * _FINE)) ** 2
    lobes = response[: _LOBES * _FINE]
    lobes = np.concatenate([lobes[:0:-1], lobes])  # from -512 to 512 cells
    share = np.convolve(lobes, np.ones(_FINE), "same")[(_LOBES * _FINE - 1) % _FINE :: _FINE]
    x = np.arange(-half, half, cell / window.broadening)
    dense = np.interp(x, node, power)
    whole = np.convolve(np.pad(dense, share.size // 2, mode="edge"), share / share.sum(), "valid")
    return np.asarray(np.interp(grid.azimuth - center, x, whole[: x.size] / dense))


def beam_edge_warning(radar: Radar, grid: ImageGrid, window: Window, cell: float) -> str:
    """Warning about rows so far off the centre of a steered beam that their level is wrong; empty when none are."""
    if not radar.antenna.directive or radar.mode_law.own_apertures or radar.track.n_pulses < 2:
        return ""
    level = db_from_power(false_level(radar, grid, window, cell))
    wrong = level > _FALSE_LEVEL_DB
    if not wrong.any():
        return ""
    azimuth = grid.azimuth
    parts = [azimuth[half & wrong] for half in (azimuth < azimuth.mean(), azimuth >= azimuth.mean())]
    spans = " and ".join(f"{part[0]:.4g} to {part[-1]:.4g} m" for part in parts if part.size)
    return (
        f"the rows at azimuth {spans} lie at the edge of the beam or outside it: side lobes and ambiguities of "
        f"illuminated ground raise their level by {level[wrong].min():.2g} dB to {level.max():.3g} dB or more; "
        "shrink image_extent_azimuth, widen the beam, or use an azimuth window of low side lobes"
    )


# deviation from 1 of the footprint's speed over the antenna's up to which a beam counts as fixed to the track: rounding
_FIXED = 1e-9
# dB by which the error of a whole image exceeded its 95 % level of some 64 pixels in drawn recordings, 99 of 100
# (benchmarks/suite/stated_errors.py --kind focusers)
UNSEEN_DB = 3.0


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
    interference_filter: str | InterferenceFilter | None = None,
    progress: Progress = silent,
) -> SarImage:
    """Focus raw data into a calibrated image, layer by layer.

    Parameters
    ----------
    raw : chirped (compressed here first) or range-compressed data, or the file of such data
    grid : pixels; default: :func:`default_grid` of ``request``, or of the data's request
    request : image request for the default grid, or a mapping with changes of that of the data, such as
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
    interference_filter : name in ``INTERFERENCE_FILTERS`` (``notch``, ``time_frequency``), with options if wanted, such
        as ``notch,threshold=6``; None and ``none``: no filter
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
    filtering, cost = parse_interference_filter(interference_filter), None
    if filtering is not None:
        check_radar(raw.radar)
        check_pulses(raw.data, "focus: ")
        raw, cost = filter_interference(range_compress(raw, method=compression), filtering)
    chain = prepare(raw, grid, request, focuser, windows, compression, motion_compensation, autofocus)
    raw, echoes, grid, focuser = chain.raw, chain.raw, chain.grid, chain.focuser
    range_window, azimuth_window = chain.windows
    corrections: dict[str, object] = {} if cost is None else {"interference_filter": cost}
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
    law_db = _add_levels(focuser.error_db(raw.radar, grid), left_db)
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
        stated = _state_error(witness, left_db, by_law=focuser.name == EXACT or turns(raw.radar))
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
        **_describe_reference(raw.radar, grid, focused, range_window),
    }
    sine = float(np.sin(incidence[incidence.size // 2]))
    share = shown_share(echoes, focused.pixels, grid, (cells.center, range_cell), sine)
    if share > 0.0:
        facts["shown_energy_db"] = round(db_from_power(share), 1)
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


def _state_error(found: Witness, left_db: float, *, by_law: bool) -> float:
    """Level that the error of an image is stated to stay below, dB, from measurements at some of its pixels.

    Errors gather in few pixels, some of which a sample misses: ``UNSEEN_DB`` above the measured level, or up to what
    the law foretold where that is less. Backprojection's law is a bound of its interpolation, and its sample small;
    of a beam that turns the errors lie at the ends of the track.
    ``left_db`` : error left by motion compensation, by law, which gathers at the image's ends.
    """
    upper = _add_levels(found.upper_db, left_db)
    if np.isnan(found.law_db):
        return upper + UNSEEN_DB
    return max(upper, found.law_db if by_law else min(upper + UNSEEN_DB, found.law_db))


def _add_levels(first: float, second: float) -> float:
    """Sum of two energies, dB."""
    return float(db_from_power(power_from_db(first) + power_from_db(second)))


def _describe_reference(
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
