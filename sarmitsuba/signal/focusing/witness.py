"""Witness of focusing: pixels of an image recomputed by exact backprojection in float64, from the same data."""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from sarmitsuba.core.arrays import C64, C128, F32, F64, I64, sum_energy
from sarmitsuba.core.constants import SPEED_OF_LIGHT
from sarmitsuba.core.errors import DataError
from sarmitsuba.core.witness import USELESS_DB, Witness
from sarmitsuba.signal.focusing.aperture_weights import direction_gain, own_aperture_weights
from sarmitsuba.signal.focusing.focuser import EXACT, Focuser
from sarmitsuba.signal.focusing.focusers.backprojection import backproject
from sarmitsuba.signal.focusing.profiles import plan_profiles
from sarmitsuba.signal.focusing.windows import Window
from sarmitsuba.signal.image import ImageGrid
from sarmitsuba.signal.raw_data import Layer, RawData

# pixels of an image, of one that is exact backprojection already, and the fewest
PIXELS, PIXELS_OF_EXACT, _FEWEST = 64, 16, 6
# one in so many is among the brightest of the image, and one of its frame this wide, pixels, where errors gather
_CERTAIN, _FRAME = 16, 2
# pixels of a scatterer's response, over which power is averaged for the chances
_RESPONSE = 5
# chance of all pixels alike, and by amplitude, over that by power, of which faint ones have none
_FAINT = 3.0
# chance by the power of a pixel's row and column, over that by its power
_CROSSED = 2.0
# part of the time of focusing that the sum may take, and seconds that are always allowed
_SHARE, _ALWAYS = 0.05, 0.1
# processor seconds of a profile's sample, and of a pixel and pulse
_SAMPLE_SECONDS, _PAIR_SECONDS = 3e-8, 2.5e-7
# products of pixels or samples and pulses at a time
_BATCH = 1 << 19
# summed weight over that of the window below which a pixel counts as not illuminated, as in backprojection
_DARK = 1e-6
_SEED = 0x5A12
# rows of a column whose contrast is measured, and the fewest; contrast of a sharp scatterer, and over that of a smear
_MOST_ROWS, _LEAST_ROWS = 1024, 32
_SHARP, _SHARPER = 6.0, 3.0
# dB, error of an image that no figure shows, of which nothing is said: scatterers beside the image leave as much of
# their single precision
_NEGLIGIBLE_DB = -80.0


def sum_exactly(raw: RawData, points: F64, range_window: Window, azimuth_window: Window) -> C128:
    r"""Backprojected pixels, every pulse summed at its own exact range in float64: (n_channels, n_points).

    The sum that :func:`sarmitsuba.signal.focusing.focusers.backprojection.backproject` states, with its windows, pulse
    weights and calibration, without its lines of pixels, without single precision and without compiled code.

    Parameters
    ----------
    raw : range-compressed data; the layers of each channel are added up
    points : (n, 3) float64, m, scene frame
    range_window, azimuth_window : over the bandwidth and over the pulses, or the pixels' apertures

    Notes
    -----
    Range profiles are transformed in single precision, as the data are, and interpolated by eight taps: -130 dB.
    """
    radar, n_pulses = raw.radar, raw.radar.track.n_pulses
    plan = plan_profiles(radar, range_window, interpolation="kernel:8")
    own = bool(np.isfinite(radar.half_aperture))
    window = np.ones(n_pulses) if own else azimuth_window.aperture(n_pulses)
    picks = [
        [i for i, layer in enumerate(raw.layers) if layer.channel == channel] for channel in raw.channels
    ]
    cycles = 2.0 * radar.waveform.center_frequency / SPEED_OF_LIGHT
    total = np.zeros((len(picks), len(points)), dtype=np.complex128)
    weight_sum = np.zeros(len(points))
    step = max(1, _BATCH // max(plan.n_fft * plan.oversampling, len(points)))
    for begin in range(0, n_pulses, step):
        part = slice(begin, min(begin + step, n_pulses))
        weight = np.broadcast_to(window[part], (len(points), part.stop - begin))
        if own:
            weight = own_aperture_weights(radar, points, part, azimuth_window)
            if not weight.any():
                continue
        lines = [points[:, None] - track.position[part] for track in radar.tracks]
        legs = [np.sqrt(np.einsum("ijk,ijk->ij", line, line)) for line in lines]
        distance = legs[0] if len(legs) == 1 else 0.5 * (legs[0] + legs[1])
        place = (distance - radar.window.start_range[part]) / plan.step
        weight = weight * ((place >= 0.0) & (place <= plan.last))
        gain = np.ones(1)
        if radar.antenna.directive:
            gain = direction_gain(radar, part, lines[0] / legs[0][..., None])
        weight_sum += np.sum(weight * gain**2, axis=1)
        weight = weight * gain * legs[0] * legs[-1]
        point, pulse = np.nonzero(weight)
        place = place[point, pulse]
        node = np.floor(place).astype(np.int64)
        turn = np.exp(2j * np.pi * np.mod(cycles * distance[point, pulse], 1.0)) * weight[point, pulse]
        taps = plan.kernel.taps(place - node)
        node += pulse * plan.n_stored
        for channel, pick in enumerate(picks):
            profiles = plan.profiles(raw.data[pick, part].sum(axis=0, dtype=np.complex64)).ravel()
            value = sum(tap * profiles[node + i] for i, tap in enumerate(taps)) * turn
            total[channel].real += np.bincount(point, value.real, len(points))
            total[channel].imag += np.bincount(point, value.imag, len(points))
    lit = weight_sum > _DARK * float(window.sum())
    scale = np.divide(1.0, weight_sum, out=np.zeros_like(weight_sum), where=lit) / radar.amplitude_constant
    return total * scale


def witness_focusing(
    raw: RawData,
    pixels: C64,
    grid: ImageGrid,
    focuser: Focuser,
    windows: tuple[Window, Window],
    law_db: float,
) -> Witness | None:
    """Error of an image against :func:`sum_exactly` at drawn pixels, in the worst channel; None of an empty image.

    The brightest pixels of some rows and of the image's frame, its corners and the middles of its edges are taken with
    certainty, others with chances that follow amplitude and power, also of their rows and columns, more in the
    frame, and leave none out.

    Parameters
    ----------
    raw : data as the focuser got them: compressed, and compensated for motion or autofocused
    pixels : (n_layers, n_azimuth, n_range) that it made
    grid : of the pixels
    focuser : that made them
    windows : over the bandwidth and over the pulses
    law_db : error stated by the focuser
    """
    channels = np.array([_sum_of(pixels, raw.layers, channel) for channel in raw.channels])
    energies = [sum_energy(one) for one in channels]
    reference = f"{EXACT} in float64"
    if not np.isfinite(energies).all():
        return Witness(math.inf, math.inf, 0, law_db, reference)
    if not any(energies):
        return None
    power: F32 = sum(
        (one.real**2 + one.imag**2) / np.float32(energy)
        for one, energy in zip(channels, energies, strict=True)
        if energy > 0.0
    )
    index, weight = _draw(power, _count(raw, grid, focuser))
    rows, columns = np.divmod(index, grid.range.size)
    across = grid.across_distance()[columns]
    flat = grid.origin * np.array([1.0, 1.0, 0.0]) + np.array([0.0, 0.0, grid.height])
    points = flat + grid.azimuth[rows, None] * grid.along + across[:, None] * grid.across
    exact = sum_exactly(raw, points, *windows)
    found = []
    for one, energy, right in zip(channels, energies, exact, strict=True):
        if energy > 0.0:
            error = weight * np.abs(one.ravel()[index] - right) ** 2
            # an image that errs that much has an energy of its own: then that of the exact sum's pixels counts
            whole = np.array([energy]) if error.sum() < 0.1 * energy else weight * np.abs(right) ** 2
            found.append(Witness.from_weighted(error, whole, _SEED, law_db=law_db))
    worst = max(found, key=lambda one: one.error_db)
    return replace(worst, reference=reference)


def _sum_of(pixels: C64, layers: Sequence[Layer], channel: str) -> C64:
    return np.asarray(
        pixels[[i for i, layer in enumerate(layers) if layer.channel == channel]].sum(0, np.complex64)
    )


def _count(raw: RawData, grid: ImageGrid, focuser: Focuser) -> int:
    """Number of pixels that take a small part of the time of focusing."""
    radar = raw.radar
    exact = (
        focuser.name == EXACT and focuser.options == type(focuser)().options
    )  # without a coarser interpolation
    most = PIXELS_OF_EXACT if exact else PIXELS
    profiles = _SAMPLE_SECONDS * len(raw.channels) * raw.data[0].size
    allowed = max(_SHARE * len(raw.layers) * focuser.cpu_seconds(radar, grid), _ALWAYS) - profiles
    return int(np.clip(allowed / (_PAIR_SECONDS * radar.track.n_pulses), min(_FEWEST, most), most))


def _draw(power: F32, count: int, seed: int = _SEED) -> tuple[I64, F64]:
    """Places of about ``count`` pixels in the flat image, and the inverse of their chances.

    Parameters
    ----------
    power : (n_azimuth, n_range) of the image
    """
    rng = np.random.default_rng(seed)
    n_columns = power.shape[1]
    frame = np.zeros(power.shape, dtype=bool)
    frame[:_FRAME] = frame[-_FRAME:] = frame[:, :_FRAME] = frame[:, -_FRAME:] = True
    few = max(1, count // _CERTAIN)
    sure = np.unique([*_brightest(power, few), *_brightest(power * frame, few)])
    if count >= PIXELS:
        rows, columns = ([0, n // 2, n - 1] for n in power.shape)
        sure = np.unique([*sure, *(i * n_columns + j for i in rows for j in columns)])
    # errors of a scatterer lie in the flanks of its response too
    near = _mean_around(power, _RESPONSE)
    amplitude = np.sqrt(near)
    chance = np.full(power.shape, _FAINT / power.size, dtype=np.float32)
    # ghosts and side lobes of a scatterer lie in its row and its column
    crossed = near.mean(axis=0) + near.mean(axis=1)[:, None]
    parts = (
        (amplitude, _FAINT),
        (near, 1.0),
        (crossed, _CROSSED),
        (amplitude * frame, 1.0),
        (near * frame, 1.0),
    )
    for part, share in parts:
        whole = float(part.sum(dtype=np.float64))
        if whole > 0.0:
            chance += part * np.float32(share / whole)
    chance.ravel()[sure] = 0.0
    rows_end = np.cumsum(chance.sum(axis=1, dtype=np.float64))
    if rows_end[-1] <= 0.0:
        return sure, np.ones(sure.size)
    # one place in each of equal parts of the chance, so that draws spread over the image
    places = np.empty(max(count - sure.size, 1), dtype=np.int64)
    for i, level in enumerate((np.arange(places.size) + rng.random()) / places.size * rows_end[-1]):
        row = min(int(np.searchsorted(rows_end, level)), power.shape[0] - 1)
        line = np.cumsum(chance[row], dtype=np.float64)
        column = int(np.searchsorted(line, level - rows_end[row] + line[-1]))
        places[i] = row * n_columns + min(column, n_columns - 1)
    drawn = chance.ravel()[places].astype(np.float64)
    share = np.divide(rows_end[-1], places.size * drawn, out=np.zeros(places.size), where=drawn > 0.0)
    return np.concatenate([sure, places]), np.concatenate([np.ones(sure.size), share])


def _brightest(power: F32, count: int) -> I64:
    """Flat places of the brightest pixels of at most ``count`` rows."""
    best = power.argmax(axis=1)
    strongest = power[np.arange(power.shape[0]), best]
    rows = np.argsort(-strongest, kind="stable")[: max(1, count)]
    return np.asarray(rows * power.shape[1] + best[rows], dtype=np.int64)


def _mean_around(power: F32, width: int) -> F32:
    """Means over squares of an odd ``width`` of pixels; nothing lies beyond the image."""
    half = width // 2
    for _ in range(2):  # along the columns of an image, then of its transpose
        padded = np.pad(power, ((half + 1, half), (0, 0)))
        total = np.cumsum(padded, axis=0, dtype=np.float64)
        power = ((total[width:] - total[:-width]) / width).T.astype(np.float32)
    return np.maximum(power, np.float32(0.0))


def conjugation_warning(raw: RawData, pixels: C64, grid: ImageGrid, windows: tuple[Window, Window]) -> str:
    r"""One line where echoes of another program focus only when conjugated; empty where they do not.

    Contrast along azimuth, :math:`n \sum |I|^4 / (\sum |I|^2)^2`, of the strongest column of the image and of the
    same pixels from conjugated echoes: 2 in clutter, far more where a scatterer is sharp.

    Notes
    -----
    Ignores images without a strong scatterer, whose contrast tells nothing. Data of this program are not tried.
    """
    if "statistics" in raw.metadata or grid.azimuth.size < _LEAST_ROWS:
        return ""
    image = _sum_of(pixels, raw.layers, raw.channels[0])
    power = image.real**2 + image.imag**2
    column = int(np.argmax(power.sum(axis=0, dtype=np.float64)))
    first = int(
        np.clip(power[:, column].argmax() - _MOST_ROWS // 2, 0, max(0, grid.azimuth.size - _MOST_ROWS))
    )
    rows = slice(first, first + _MOST_ROWS)
    line = replace(grid, azimuth=grid.azimuth[rows], range=grid.range[column : column + 1])
    other = replace(raw, data=raw.total().conj()[None], layers=(Layer(raw.channels[0]),))
    turned = backproject(
        other, line.positions().reshape(-1, 3), range_window=windows[0], azimuth_window=windows[1]
    )
    plain, conjugated = _contrast(image[rows, column]), _contrast(turned[0])
    if conjugated < max(_SHARP, _SHARPER * plain):
        return ""
    return (
        f"the echoes focus when they are conjugated (contrast along azimuth {conjugated:.3g} instead of {plain:.3g}): "
        "their phase rises with range; give their complex conjugate"
    )


def _contrast(values: C64) -> float:
    power = np.abs(values.astype(np.complex128)) ** 2
    whole = float(power.sum()) ** 2
    return float(power.size * np.sum(power**2)) / whole if whole > 0.0 else 0.0


def witness_warning(found: Witness, focuser: Focuser) -> str:
    """One line where an image errs by more than its focuser stated and by more than rounding; empty where it does not.

    Raises
    ------
    DataError
        The image is of no use, and nothing foretold it: a focuser's ``bound`` that was raised by hand does.
    """
    remedy = f"{EXACT},interpolation=kernel:8" if focuser.name == EXACT else EXACT
    errs = (
        f"the image of focuser {focuser.name} has an error of {found.error_db:.1f} dB, measured in this run against "
        f"{found.reference} at {found.samples} pixels"
    )
    if found.useless:
        text = f"{errs}: it is of no use; take focuser {remedy}"
        if found.law_db > USELESS_DB:
            return text
        raise DataError(f"focus: {text}")
    if not found.contradicts or found.error_db < _NEGLIGIBLE_DB:
        return ""
    return f"{errs}; a formula expected {found.law_db:.1f} dB; take focuser {remedy}"
