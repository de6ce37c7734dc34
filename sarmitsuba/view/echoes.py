"""Picture of raw data: level of the echoes over range or fast time and pulse."""

import numpy as np

from sarmitsuba.core.constants import SPEED_OF_LIGHT
from sarmitsuba.core.units import db_from_power
from sarmitsuba.signal.raw.raw_data import RawData
from sarmitsuba.view.figure import Figure

# most pulses and samples drawn; blocks of more are drawn by their strongest sample
_MOST = 1000
# dB from black to white
_SPAN_DB = 50.0


def echoes_figure(raw: RawData, channel: str | None = None) -> Figure:
    """Draw the level of one channel (default: the first), dB of the strongest sample; first pulse below.

    Blocks of samples that share a pixel of the picture are drawn by the strongest. The axis of range is that of the
    first pulse; windows of later pulses may start elsewhere, which bends the echoes of a point.

    Parameters
    ----------
    raw : range-compressed or chirped echoes
    channel : polarisation; None: the first
    """
    name = channel or raw.channels[0]
    power = np.square(np.abs(raw.total(name)))
    rows, columns = (-(-n // _MOST) for n in power.shape)
    padded = np.pad(power, [(0, -power.shape[0] % rows), (0, -power.shape[1] % columns)])
    strongest = padded.reshape(padded.shape[0] // rows, rows, -1, columns).max(axis=(1, 3))
    level = db_from_power(strongest / max(float(strongest.max()), 1e-300))
    window, radar = raw.radar.window, raw.radar
    first = float(window.start_range[0])
    if raw.domain == "compressed":
        start, step, label = first, window.sample_spacing, "slant range (m)"
    else:
        start = 1e6 * (2.0 * first / SPEED_OF_LIGHT - 0.5 * radar.waveform.pulse_width)
        step, label = 1e6 / window.sampling_rate, "time after transmission (us)"
    figure = Figure(figsize=(6.4, 4.2), dpi=100, layout="constrained")
    axes = figure.add_subplot()
    extent = (start, start + step * padded.shape[1], 0.0, float(padded.shape[0]))
    shown = axes.imshow(
        np.maximum(level, -_SPAN_DB),
        cmap="gray",
        vmin=-_SPAN_DB,
        vmax=0.0,
        extent=extent,
        aspect="auto",
        origin="lower",
        interpolation="nearest",
    )
    axes.set(xlabel=label, ylabel="pulse")
    axes.ticklabel_format(useOffset=False, style="plain")
    axes.set_title(f"{name}, {raw.domain} echoes", fontsize=9, parse_math=False)
    figure.colorbar(shown, ax=axes, label="dB of the strongest sample")
    return figure
