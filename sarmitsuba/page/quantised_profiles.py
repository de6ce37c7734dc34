"""Recorded pulses as the page's backprojection reads them: cropped to the image, referred to its centre, quantised."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sarmitsuba.echo.pulse_motion import standing_still
from sarmitsuba.echo.raw_data import RawData
from sarmitsuba.errors import DataError
from sarmitsuba.focusing.aperture_weights import beam_turn, flight
from sarmitsuba.focusing.windows import Window, parse_window
from sarmitsuba.image.sar_image import ImageGrid
from sarmitsuba.radar.radar import Radar

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]

# bins kept before and behind the image's own: what a range window's side lobes reach
_GUARD = 64
# windows that a page offers beside those that its image was made with
_OFFERED = ("rectangular", "taylor", "hamming")
# places from one end of a window to the other at which the page is given it; linear between them to 1e-5
_NODES = 1025
# nodes of a measured beam's cuts that a page is given at most
_CUT_NODES = 4097
# points on each edge of the image at which its ranges are looked up
_EDGE = 65
# largest value of an int16 that has its negative
_FULL = 32767

# what the page reads: JSON for the numbers, little-endian arrays for the rest
Header = dict[str, "float | int | str | list[float] | list[str] | Header | None"]
Arrays = dict[str, NDArray[np.generic]]


@dataclass(frozen=True, eq=False)
class PageProfiles:
    r"""Range-compressed pulses of one channel, as ``web/backprojector.js`` reads them.

    .. math:: q_t(r) = \frac{R_{0,t}^2}{K} s_t(r) e^{+j 4 \pi R_{0,t} / \lambda}

    with :math:`R_{0,t}` the distance from the antenna to the image's centre and K the radar's amplitude constant: the
    sum over pulses, over their weights' sum, is the calibrated image.

    Parameters
    ----------
    radar : as recorded
    antenna : (n_pulses, 3) float64, m, from the image's centre
    first_bin : (n_pulses,) float64, m, slant range of bin 0 less the reference range
    samples : (n_pulses, n_bins, 2) int16, real and imaginary part
    scale : (n_pulses,) float32, m, value of one step of ``samples``
    range_window, azimuth_window : those that the image was focused with

    Notes
    -----
    A sample's rounding is 2^-16 of its pulse's largest magnitude at most: -101 dB of it rms, and other in every
    pulse. Echoes from beyond the crop's guard of bins are lost, with what their side lobes would have added.
    """

    radar: Radar
    antenna: F64
    first_bin: F64
    samples: NDArray[np.int16]
    scale: F32
    range_window: Window
    azimuth_window: Window

    @property
    def reference_range(self) -> F64:
        """(n_pulses,) float64, m, distance from the antenna to the image's centre."""
        return np.asarray(np.linalg.norm(self.antenna, axis=1))

    def payload(self) -> tuple[Header, Arrays]:
        """Numbers and arrays of ``data`` by the names that the page gives them, nested ones with a dot."""
        radar, n = self.radar, self.radar.track.n_pulses
        wave, window = radar.waveform, radar.window
        header: Header = {
            "wavelength": wave.wavelength,
            "nPulses": n,
            "nBins": self.samples.shape[1],
            "binSpacing": window.sample_spacing,
            "bandFraction": wave.bandwidth / window.sampling_rate,
            "beam": None,
            "band": None,
        }
        arrays: Arrays = {
            "antenna": self.antenna,
            "referenceRange": self.reference_range,
            "firstBin": self.first_bin,
            "profiles": self.samples,
            "scale": self.scale,
            "weights": np.ones(n, dtype=np.float32),
        }
        if radar.antenna.pattern != "isotropic":
            header["beam"] = {"pattern": radar.antenna.pattern, "perWidth": list(radar.antenna.per_width)}
            if radar.antenna.table is not None:
                for name, cut in zip(("azimuth", "elevation"), radar.antenna.table.cuts, strict=True):
                    sine = np.linspace(cut.sine[0], cut.sine[-1], min(cut.sine.size, _CUT_NODES))
                    arrays[f"beam.{name}Sine"] = sine[[0, -1]]
                    arrays[f"beam.{name}Gain"] = np.interp(sine, cut.sine, cut.nodes).astype(np.float32)
            pointing = radar.pointing
            for name, axis in (
                ("azimuthAxis", pointing.azimuth_axis),
                ("elevationAxis", pointing.elevation_axis),
                ("boresight", pointing.boresight),
            ):
                arrays[f"beam.{name}"] = axis.astype(np.float32)
        if np.isfinite(radar.half_aperture):
            header["band"] = {"half": radar.half_aperture}
            forward, center, gap = flight(radar)
            arrays |= {"band.forward": forward.astype(np.float32), "band.center": center, "band.gap": gap}
            arrays["band.turn"] = beam_turn(radar)
        own = (self.range_window, self.azimuth_window)
        windows = {str(window): window for window in (*own, *map(parse_window, _OFFERED))}
        header["windows"] = {"texts": list(windows), "range": str(own[0]), "azimuth": str(own[1])}
        places = np.linspace(-0.5, 0.5, _NODES)
        arrays["windows.nodes"] = np.array([w(places) for w in windows.values()], dtype=np.float32)
        return header, arrays


def page_center(grid: ImageGrid) -> F64:
    """(3,) float64, m, scene frame: the pixel in the image's middle, to which the page refers ranges."""
    rows, columns = grid.shape
    return np.asarray(grid.positions_on_line(rows // 2)[columns // 2])


def page_profiles(
    raw: RawData,
    grid: ImageGrid,
    channel: str | None = None,
    *,
    range_window: str | Window = "rectangular",
    azimuth_window: str | Window = "rectangular",
) -> PageProfiles:
    """Cut, refer and quantise the range-compressed pulses of one channel.

    Parameters
    ----------
    raw : range-compressed data, see :func:`sarmitsuba.focusing.range_compression.range_compress`
    grid : image that the page is to focus; in the frame of the radar or of the file
    channel : polarisation, None for the first
    range_window, azimuth_window : those of the image, with which the page starts; the data themselves stay as they are

    Raises
    ------
    DataError
        Unknown window, the data are chirped, the channel is not there, or nothing of the image was recorded.
    """
    if raw.domain != "compressed":
        raise DataError("page: the data are not range compressed; call range_compress first")
    raw = standing_still(raw)
    radar, grid = raw.radar, grid.in_frame(raw.radar.offset)
    if radar.receiver is not None:
        raise DataError("page: it focuses the echoes of one antenna, and these have two")
    window = radar.window
    center = page_center(grid)
    antenna = radar.track.position - center
    reference = np.linalg.norm(antenna, axis=1)

    near, far = _ranges(radar, grid)
    if not ((far >= window.start_range) & (near <= window.start_range + window.extent)).any():
        raise DataError("page: no pulse recorded any range of the image; move the image's centre")
    first = np.floor((near - window.start_range) / window.sample_spacing).astype(np.int64) - _GUARD
    last = np.ceil((far - window.start_range) / window.sample_spacing).astype(np.int64) + _GUARD
    n_bins = int(min((last - first).max() + 1, window.n_samples))
    first = np.clip(first, 0, window.n_samples - n_bins)  # only what was recorded

    columns = first[:, None] + np.arange(n_bins)
    data = np.take_along_axis(raw.total(channel), columns, axis=1).astype(np.complex128)
    turns = 2.0 * reference / radar.waveform.wavelength
    factor = (reference**2 / radar.amplitude_constant) * np.exp(2j * np.pi * (turns - np.round(turns)))
    data *= factor[:, None]
    parts = np.stack([data.real, data.imag], axis=-1)
    largest = np.abs(parts).max(axis=(1, 2))
    scale = np.where(largest > 0.0, largest, 1.0) / _FULL
    return PageProfiles(
        radar=radar,
        antenna=antenna,
        first_bin=window.start_range + first * window.sample_spacing - reference,
        samples=np.round(parts / scale[:, None, None]).astype(np.int16),
        scale=scale.astype(np.float32),
        range_window=parse_window(range_window),
        azimuth_window=parse_window(azimuth_window),
    )


def _ranges(radar: Radar, grid: ImageGrid) -> tuple[F64, F64]:
    """Shortest and longest slant range of the image from every pulse, (n_pulses,) float64, m.

    Looked up on a lattice that has the image's edges, to its own coarseness: the crop's guard is wider.
    """
    rows, columns = (np.unique(np.linspace(0, n - 1, _EDGE).round().astype(np.int64)) for n in grid.shape)
    points = np.concatenate([grid.positions_on_line(int(row))[columns] for row in rows])
    distance = (np.linalg.norm(points - position, axis=1) for position in radar.track.position)
    ends = np.array([(d.min(), d.max()) for d in distance])
    return ends[:, 0], ends[:, 1]


def page_grid(grid: ImageGrid) -> tuple[Header, Arrays]:
    """Numbers and arrays of the page's ``grid``, positions from :func:`page_center`.

    Returns
    -------
    header : ``nx``, ``ny``, ``kind`` (``slant`` or ``ground``), ``origin``, ``along``, ``across`` (m and unit vectors
        from the image's centre, scene axes), ``center`` (of the image, m, frame of the user's file)
    arrays : ``rows``, ``columns`` (float64, m along and across from ``origin``), ``azimuth``, ``range`` (float64, m, as
        in the image's own axes)
    """
    center = page_center(grid)
    start = grid.origin * np.array([1.0, 1.0, 0.0]) + np.array([0.0, 0.0, grid.height])
    header: Header = {
        "nx": grid.shape[1],
        "ny": grid.shape[0],
        "kind": grid.kind,
        "origin": (start - center).tolist(),
        "along": grid.along.tolist(),
        "across": grid.across.tolist(),
        "center": (center + grid.offset).tolist(),
    }
    arrays: Arrays = {
        "rows": grid.azimuth,
        "columns": grid.across_distance(),
        "azimuth": grid.azimuth,
        "range": grid.range,
    }
    return header, arrays


__all__ = ["PageProfiles", "page_center", "page_grid", "page_profiles"]
