"""Range profiles for the page's backprojection: cropped to the image, referred to its centre, quantised."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sarmitsuba.core.arrays import F32, F64
from sarmitsuba.core.errors import DataError
from sarmitsuba.radar.antenna import Antenna
from sarmitsuba.radar.radar import Radar
from sarmitsuba.signal.focusing.aperture_weights import beam_turn, flight
from sarmitsuba.signal.focusing.windows import Window, parse_window
from sarmitsuba.signal.image import ImageGrid, ShownAxes
from sarmitsuba.signal.pulse_motion import standing_still
from sarmitsuba.signal.raw_data import RawData

# range bins kept before and behind those of the image, for the side lobes of a range window
_GUARD = 64
# windows offered by a page beside those of its image
_OFFERED = ("rectangular", "taylor", "hamming")
# samples of a window stored in the page; linear interpolation is accurate to 1e-5
_NODES = 1025
# most samples of a measured antenna cut stored in a page
_CUT_NODES = 4097
# of both sines, for a pattern that is no product of cuts
_MAP_NODES = 257
# half-power half-widths that are sampled; difference from a product of cuts that shows nowhere, -60 dB of the peak
_REACH, _SEPARABLE = 8.0, 1e-3
# patterns that the page knows by their formula
_FORMULAS = ("gaussian", "rectangular")
# points on each edge of the image at which its ranges are evaluated
_EDGE = 65
# largest int16 value whose negative exists
_FULL = 32767

# content for the page: JSON for the numbers, little-endian arrays for the rest
Header = dict[str, "float | int | str | list[float] | list[str] | Header | None"]
Arrays = dict[str, NDArray[np.generic]]


@dataclass(frozen=True, eq=False)
class PageProfiles:
    r"""Range-compressed pulses of one channel in the form used by ``web/backprojector.js``.

    .. math:: q_t(r) = \frac{R_{0,t}^2}{K} s_t(r) e^{+j 4 \pi R_{0,t} / \lambda}

    with :math:`R_{0,t}` the distance from the antenna to the image's centre and K the radar's amplitude constant: the
    weighted mean over pulses is the calibrated image.

    Parameters
    ----------
    radar : as recorded
    antenna : (n_pulses, 3) float64, m, from the image's centre
    first_bin : (n_pulses,) float64, m, slant range of bin 0 minus the reference range
    samples : (n_pulses, n_bins, 2) int16, real and imaginary part
    scale : (n_pulses,) float32, m, value of one step of ``samples``
    range_window, azimuth_window : with which the image was focused

    Notes
    -----
    The rounding error of a sample is at most 2^-16 of its pulse's largest magnitude, -101 dB rms, and independent from
    pulse to pulse. Echoes from beyond the guard bins are lost, with their side lobes.
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
        """Numbers and arrays of ``data`` by their names in the page, nested ones with a dot."""
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
        if radar.antenna.directive:
            header["beam"] = {
                "pattern": radar.antenna.pattern if radar.antenna.pattern in _FORMULAS else "sampled",
                "perWidth": list(radar.antenna.per_width),
            }
            if radar.antenna.pattern not in _FORMULAS:
                arrays |= sample_beam(radar.antenna)
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


def sample_beam(antenna: Antenna) -> Arrays:
    """Gain of a beam on a grid of sines: ends and nodes of both axes.

    A product of two cuts is one row and one column; any other pattern is a grid of both sines.

    Notes
    -----
    The page interpolates linearly between nodes, and holds the last value beyond the ends: those of a table, or eight
    half-power half-widths.
    """
    if antenna.table is not None:
        found: Arrays = {}
        for name, cut in zip(("azimuth", "elevation"), antenna.table.cuts, strict=True):
            sine = np.linspace(cut.sine[0], cut.sine[-1], min(cut.sine.size, _CUT_NODES))
            found[f"beam.{name}Sine"] = sine[[0, -1]]
            found[f"beam.{name}Gain"] = np.interp(sine, cut.sine, cut.nodes).astype(np.float32)
        return found
    ends = [(-reach, reach) for reach in (min(1.0, _REACH / scale) for scale in antenna.per_width)]
    azimuth, elevation = (np.linspace(*end, _CUT_NODES) for end in ends)
    nothing = np.zeros(_CUT_NODES)
    cuts = [antenna.two_way_amplitude(azimuth, nothing), antenna.two_way_amplitude(nothing, elevation)]
    arrays: Arrays = {"beam.azimuthSine": np.array(ends[0]), "beam.elevationSine": np.array(ends[1])}
    places = np.linspace(0.02, 0.98, 25)[:, None] * np.array([np.ptp(azimuth), np.ptp(elevation)]) + [
        azimuth[0],
        elevation[0],
    ]
    a, e = places[:, :1], places[None, :, 1]
    whole = antenna.two_way_amplitude(a + 0.0 * e, e + 0.0 * a)
    product = np.interp(a, azimuth, cuts[0]) * np.interp(e, elevation, cuts[1])
    if np.abs(whole - product).max() < _SEPARABLE:
        arrays |= {
            "beam.azimuthGain": cuts[0].astype(np.float32),
            "beam.elevationGain": cuts[1].astype(np.float32),
        }
        return arrays
    a, e = (np.linspace(*end, _MAP_NODES) for end in ends)
    plane = antenna.two_way_amplitude(a[:, None] + 0.0 * e, e + 0.0 * a[:, None])
    return arrays | {"beam.gain": np.asarray(plane, dtype=np.float32).ravel()}


def page_center(grid: ImageGrid) -> F64:
    """Position of the central pixel, to which the page refers ranges, (3,) float64, m, scene frame."""
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
    """Crop the range-compressed pulses of one channel, refer them to the image's centre, and quantise them.

    Parameters
    ----------
    raw : range-compressed data, see :func:`sarmitsuba.signal.focusing.range_compression.range_compress`
    grid : of the image to focus in the page; in the frame of the radar or of the file
    channel : polarisation; None: the first
    range_window, azimuth_window : those of the image, with which the page starts; they are not applied to the data

    Raises
    ------
    DataError
        Unknown window or channel, the data are not range compressed, or no range of the image was recorded.
    """
    if raw.domain != "compressed":
        raise DataError("page: the data are not range compressed; call range_compress first")
    raw = standing_still(raw)
    radar, grid = raw.radar, grid.in_frame(raw.radar.offset)
    if radar.receiver is not None:
        raise DataError("page: bistatic data are not focused in the page; give monostatic data")
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
    first = np.clip(first, 0, window.n_samples - n_bins)  # recorded samples only

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

    Evaluated on a lattice that includes the image's edges; its error is smaller than the guard of the crop.
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
        from the image's centre, scene axes), ``center`` (of the image, m, frame of the user's file), ``axes`` (labels
        of ``azimuth`` and ``range``, as in pictures)
    arrays : ``rows``, ``columns`` (float64, m along and across from ``origin``), ``azimuth``, ``range`` (float64, m, as
        pictures count them: on the ground in coordinates of the scene, see
        :class:`sarmitsuba.signal.image.ShownAxes`)
    """
    center, axes = page_center(grid), ShownAxes.of(grid)
    across, up = axes.shown(grid.azimuth, grid.range)
    start = grid.origin * np.array([1.0, 1.0, 0.0]) + np.array([0.0, 0.0, grid.height])
    header: Header = {
        "nx": grid.shape[1],
        "ny": grid.shape[0],
        "kind": grid.kind,
        "origin": (start - center).tolist(),
        "along": grid.along.tolist(),
        "across": grid.across.tolist(),
        "center": (center + grid.offset).tolist(),
        "axes": {"along": axes.azimuth_label, "across": axes.range_label},
    }
    arrays: Arrays = {
        "rows": grid.azimuth,
        "columns": grid.across_distance(),
        "azimuth": up,
        "range": across,
    }
    return header, arrays
