"""Witness of focusing: pixels of an image recomputed by exact backprojection in float64, from the same data."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from sarmitsuba.arrays import C64, C128, F32, F64, I64
from sarmitsuba.constants import SPEED_OF_LIGHT
from sarmitsuba.echo.raw_data import Layer, RawData
from sarmitsuba.errors import DataError
from sarmitsuba.focusing.aperture_weights import direction_gain, own_aperture_weights
from sarmitsuba.focusing.focuser import EXACT, Focuser
from sarmitsuba.focusing.profiles import plan_profiles
from sarmitsuba.focusing.windows import Window
from sarmitsuba.image.sar_image import ImageGrid
from sarmitsuba.witness import Witness

# pixels of an image, of one that is exact backprojection already, and the fewest
PIXELS, PIXELS_OF_EXACT, _FEWEST = 64, 16, 6
# part of them that are the brightest; the corners and middles of the edges are certain too
_BRIGHT = 0.25
# part of the time of focusing that the sum may take, and seconds that are always allowed
_SHARE, _ALWAYS = 0.05, 0.1
# processor seconds of a profile's sample, and of a pixel and pulse
_SAMPLE_SECONDS, _PAIR_SECONDS = 3e-8, 2.5e-7
# products of pixels or samples and pulses at a time
_BATCH = 1 << 19
# summed weight over that of the window below which a pixel counts as not illuminated, as in backprojection
_DARK = 1e-6
_SEED = 0x5A12


def sum_exactly(raw: RawData, points: F64, range_window: Window, azimuth_window: Window) -> C128:
    r"""Backprojected pixels, every pulse summed at its own exact range in float64: (n_channels, n_points).

    The sum that :func:`sarmitsuba.focusing.focusers.backprojection.backproject` states, with its windows, pulse weights
    and calibration, without its lines of pixels, without single precision and without compiled code.

    Parameters
    ----------
    raw : range-compressed data; the layers of each channel are added up
    points : (n, 3) float64, m, scene frame
    range_window, azimuth_window : over the bandwidth and over the pulses, or the pixels' own apertures

    Notes
    -----
    Range profiles are transformed in single precision, the data's own, and interpolated by eight taps: -130 dB.
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

    The brightest pixels of some rows, the image's corners and the middles of its edges are taken with certainty, others
    with chances that follow amplitude and power and leave none out.

    Parameters
    ----------
    raw : data as the focuser got them: compressed, and compensated for motion or autofocused
    pixels : (n_layers, n_azimuth, n_range) that it made
    grid : of the pixels
    focuser : that made them
    windows : over the bandwidth and over the pulses
    law_db : what the focuser stated
    """
    channels = np.array([_sum_of(pixels, raw.layers, channel) for channel in raw.channels])
    energies = [float(np.vdot(one, one).real) for one in channels]
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
    for one, energy, reference in zip(channels, energies, exact, strict=True):
        if energy > 0.0:
            error = weight * np.abs(one.ravel()[index] - reference) ** 2
            # an image that errs that much has an energy of its own: then that of the exact sum's pixels counts
            whole = np.array([energy]) if error.sum() < 0.1 * energy else weight * np.abs(reference) ** 2
            found.append(Witness.from_weighted(error, whole, _SEED, law_db=law_db))
    worst = max(found, key=lambda one: one.error_db)
    return replace(worst, reference=f"{EXACT} in float64")


def _sum_of(pixels: C64, layers: Sequence[Layer], channel: str) -> C64:
    return np.asarray(
        pixels[[i for i, layer in enumerate(layers) if layer.channel == channel]].sum(0, np.complex64)
    )


def _count(raw: RawData, grid: ImageGrid, focuser: Focuser) -> int:
    """Number of pixels that take a small part of the time of focusing."""
    radar = raw.radar
    most = PIXELS_OF_EXACT if focuser.name == EXACT else PIXELS
    profiles = _SAMPLE_SECONDS * len(raw.channels) * raw.data[0].size
    allowed = max(_SHARE * len(raw.layers) * focuser.cpu_seconds(radar, grid), _ALWAYS) - profiles
    return int(np.clip(allowed / (_PAIR_SECONDS * radar.track.n_pulses), min(_FEWEST, most), most))


def _draw(power: F32, count: int) -> tuple[I64, F64]:
    """Places of about ``count`` pixels in the flat image, and the inverse of their chances.

    Parameters
    ----------
    power : (n_azimuth, n_range) of the image; certain places are set to zero here
    """
    rng = np.random.default_rng(_SEED)
    n_rows, n_columns = power.shape
    best = power.argmax(axis=1)
    strongest = power[np.arange(n_rows), best]
    bright = np.argsort(-strongest, kind="stable")[: max(1, int(_BRIGHT * count))]
    certain = list(bright * n_columns + best[bright])
    ends = [(i, j) for i in (0, n_rows // 2, n_rows - 1) for j in (0, n_columns // 2, n_columns - 1)]
    if count >= 2 * len(ends):
        certain += [i * n_columns + j for i, j in ends if (i, j) != (n_rows // 2, n_columns // 2)]
    sure = np.unique(np.array(certain, dtype=np.int64))
    power.ravel()[sure] = 0.0
    # three equal parts of the chance: even, by amplitude, by power
    parts = [np.full(n_rows, float(n_columns)), np.sqrt(power).sum(axis=1, dtype=np.float64)]
    parts.append(power.sum(axis=1, dtype=np.float64))
    parts = [part / part.sum() for part in parts if part.sum() > 0.0]
    drawn = max(count - sure.size, 1)
    places, chances = np.empty(drawn, dtype=np.int64), np.empty(drawn)
    row_chance = np.mean(parts, axis=0)
    amplitude, energy = float(np.sqrt(power).sum(dtype=np.float64)), float(power.sum(dtype=np.float64))
    for i, row in enumerate(rng.choice(n_rows, drawn, p=row_chance / row_chance.sum())):
        line = power[row].astype(np.float64)
        shares = [np.full(n_columns, 1.0 / power.size)]
        if energy > 0.0:
            shares += [np.sqrt(line) / amplitude, line / energy]
        chance = np.mean(shares, axis=0)
        column = rng.choice(n_columns, p=chance / chance.sum())
        places[i], chances[i] = row * n_columns + column, chance[column]
    # pixels taken with certainty do not stand for others
    share = np.where(np.isin(places, sure), 0.0, 1.0 / (drawn * chances))
    return np.concatenate([sure, places]), np.concatenate([np.ones(sure.size), share])


def witness_warning(found: Witness, focuser: Focuser) -> str:
    """One line where an image errs by more than its focuser stated; empty where it does not.

    Raises
    ------
    DataError
        The image is of no use.
    """
    remedy = f"{EXACT},interpolation=kernel:8" if focuser.name == EXACT else EXACT
    errs = (
        f"the image of focuser {focuser.name} errs by {found.error_db:.1f} dB, measured against {found.reference} at "
        f"{found.samples} pixels"
    )
    if found.useless:
        raise DataError(f"focus: {errs}: it is of no use; take focuser {remedy}")
    return f"{errs}; it stated {found.law_db:.1f} dB; take focuser {remedy}" if found.contradicts else ""
