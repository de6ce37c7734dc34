"""Autofocus: estimation of the track's error along the line of sight, pulse by pulse, from the data.

It reads phase histories of selected pixels, the terms of backprojection's sum.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
import scipy.fft

from sarmitsuba.core.arrays import C64, F64
from sarmitsuba.core.errors import DataError
from sarmitsuba.core.progress import Progress, silent
from sarmitsuba.core.registry import Registry
from sarmitsuba.radar.radar import Radar
from sarmitsuba.signal.focusing.aperture_weights import matched_weights
from sarmitsuba.signal.focusing.focuser import Focuser, FocusTask, WithOptions, parse_optional
from sarmitsuba.signal.focusing.profiles import plan_profiles
from sarmitsuba.signal.focusing.windows import Window, parse_window
from sarmitsuba.signal.image import ImageGrid
from sarmitsuba.signal.raw_data import RawData

# zeros beyond the end of a pulse while it is shifted
_GUARD = 64


@dataclass(frozen=True, eq=False)
class AutofocusTask:
    """Input of an autofocuser: one channel of range-compressed data, and the focusing of an image from them.

    Parameters
    ----------
    raw : one layer, range compressed
    grid : pixels
    focuser : makes the images
    range_window, azimuth_window : of the image
    progress : called after every round
    """

    raw: RawData
    grid: ImageGrid
    focuser: Focuser
    range_window: Window
    azimuth_window: Window
    progress: Progress = silent

    def corrected(self, error: F64) -> RawData:
        """Data corrected for a range error (n_pulses,), m."""
        return correct_ranges(self.raw, error)

    def image(self, error: F64) -> C64:
        """Image (n_azimuth, n_range), complex64, of the data corrected for a range error (n_pulses,), m."""
        raw = self.corrected(error)
        task = FocusTask(raw, self.grid, self.range_window, self.azimuth_window, silent)
        return np.asarray(self.focuser.focus(task).pixels[0])


@dataclass(frozen=True)
class Autofocuser(WithOptions, ABC):
    """Autofocus algorithm: a frozen dataclass whose fields are its options; registered in ``AUTOFOCUSERS``.

    Attributes
    ----------
    name : in commands and calls
    title : purpose in one line
    """

    kind: ClassVar[str] = "autofocus"
    name: ClassVar[str]
    title: ClassVar[str]

    @abstractmethod
    def estimate(self, task: AutofocusTask) -> F64:
        """Range error of every pulse, (n_pulses,) float64, m: true minus recorded range to the scene."""


AUTOFOCUSERS: Registry[Autofocuser] = Registry(
    "autofocus", Autofocuser, "sarmitsuba.signal.focusing.autofocusers"
)


def parse_autofocus(text: str | Autofocuser | None) -> Autofocuser | None:
    """Read an autofocuser from its name and options; see :func:`sarmitsuba.signal.focusing.focuser.parse_optional`."""
    return parse_optional(text, AUTOFOCUSERS)


def remove_error(raw: RawData, method: Autofocuser, task: AutofocusTask) -> tuple[RawData, dict[str, object]]:
    """Data corrected for the range error that an autofocuser estimates from one channel, and facts about it.

    Parameters
    ----------
    raw : range compressed, all layers
    method : the autofocuser
    task : of the first channel of the same data

    Raises
    ------
    DataError
        There are fewer than 16 pulses, or only zeros.
    """
    if raw.radar.track.n_pulses < 16:
        raise DataError(f"autofocus: {raw.radar.track.n_pulses} pulses are too few, at least 16 are needed")
    if not np.any(task.raw.data):
        raise DataError("autofocus: the data are all zero")
    error = method.estimate(task)
    facts: dict[str, object] = {
        "method": method.name,
        **method.options,
        "range_error_rms": float(np.sqrt(np.mean(error**2))),
        "range_error_peak": float(np.abs(error).max()),
    }
    return correct_ranges(raw, error), facts


def correct_ranges(raw: RawData, error: F64) -> RawData:
    r"""Data shifted nearer by a range error: the spectra times :math:`e^{j (k_c + \kappa) e_t}`.

    Parameters
    ----------
    raw : range compressed
    error : (n_pulses,) float64, m
    """
    window = raw.radar.window
    n = int(scipy.fft.next_fast_len(window.n_samples + _GUARD))
    kappa = 2.0 * np.pi * scipy.fft.fftfreq(n, window.sample_spacing)
    kc = 4.0 * np.pi / raw.radar.waveform.wavelength
    turn = np.exp(1j * (np.mod(kc * error, 2.0 * np.pi)[:, None] + np.outer(error, kappa))).astype(
        np.complex64
    )
    data = np.empty_like(raw.data)
    for layer, plane in enumerate(raw.data):
        spectrum = scipy.fft.fft(plane, n=n, axis=1, workers=-1) * turn
        data[layer] = scipy.fft.ifft(spectrum, axis=1, workers=-1)[:, : window.n_samples]
    return replace(raw, data=data)


def apply_autofocus_records(raw: RawData) -> RawData:
    """Data corrected by the autofocus records that came with them.

    Parameters
    ----------
    raw : range compressed, with ``autofocus_records``

    Returns
    -------
    RawData without records; ``metadata`` says that they were applied

    Raises
    ------
    DataError
        A channel has no records, or the data are chirped.

    Notes
    -----
    An error that differs over the scene is not modelled.
    """
    without = [channel for channel in raw.channels if channel not in raw.autofocus_records]
    if without:
        raise DataError(f"autofocus records: channel {without[0]} has none; leave --autofocus-records out")
    if raw.domain != "compressed":
        raise DataError("autofocus records: the data are chirped; range compress them first")
    data = np.empty_like(raw.data)
    for i, layer in enumerate(raw.layers):
        records = raw.autofocus_records[layer.channel]
        one = replace(raw, data=raw.data[i : i + 1], layers=(layer,), autofocus_records={})
        turn = np.exp(1j * records.phase_correction).astype(np.complex64)
        data[i] = correct_ranges(one, -records.range_correction).data[0] * turn[:, None]
    return replace(
        raw, data=data, autofocus_records={}, metadata={**raw.metadata, "autofocus_records": "applied"}
    )


def remove_trend(radar: Radar, error: F64, weight: F64) -> F64:
    """Range error without its constant and its slope, which only shift the image.

    Parameters
    ----------
    radar : gives the pulses' times
    error : (n_pulses,) float64, m
    weight : (n_pulses,) weight of each pulse in the fit of the slope; small where a pulse shows nothing
    """
    share = weight / weight.sum()
    time = radar.track.time - share @ radar.track.time
    mean = float(share @ error)
    slope = float((share * time) @ (error - mean)) / float((share * time) @ time)
    return np.asarray(error - mean - slope * time)


# (point, pulse) pairs processed at once
_BATCH = 1 << 19


def pulse_contributions(
    data: C64, radar: Radar, points: F64, range_window: str | Window, azimuth_window: str | Window
) -> C64:
    r"""Terms of backprojection's sum, :math:`b_{pt} = w_t g_t^2 R_t^2 s_t(R_t) e^{j k_c R_t}`, :math:`R_t = |p - A_t|`.

    Parameters
    ----------
    data : (n_pulses, n_samples) complex64, range compressed
    radar : gives track, window, antenna and waveform
    points : (n, 3) float64, m, scene frame
    range_window, azimuth_window : as in ``backproject``

    Returns
    -------
    (n, n_pulses) complex64, with one factor of the beam's gain more than the pixel, which reduces the weight of the
    beam's edge; zero for pulses that do not illuminate the point or whose window does not contain it
    """
    plan = plan_profiles(radar, parse_window(range_window), interpolation="kernel:4")
    kernel = plan.kernel
    profiles = plan.profiles(data)
    row = np.arange(radar.track.n_pulses) * plan.n_stored
    wavenumber = 4.0 * np.pi / radar.waveform.wavelength
    out = np.empty((points.shape[0], radar.track.n_pulses), dtype=np.complex64)
    step = max(1, _BATCH // radar.track.n_pulses)
    for start in range(0, points.shape[0], step):
        point = points[start : start + step]
        distance = np.linalg.norm(point[:, None] - radar.track.position, axis=-1)
        place = (distance - radar.window.start_range) / plan.step
        inside = (place >= 0.0) & (place <= plan.last)
        place = np.where(inside, place, 0.0)
        base = np.floor(place)
        index = row + base.astype(np.int64)
        value = np.zeros(distance.shape, dtype=np.complex64)
        for k, tap in enumerate(kernel.taps(place - base)):
            value += profiles.ravel()[np.minimum(index + k, profiles.size - 1)] * tap.astype(np.float32)
        weight = matched_weights(radar, point, azimuth_window) * inside * distance**2
        out[start : start + step] = value * weight * np.exp(1j * np.mod(wavenumber * distance, 2.0 * np.pi))
    return out
