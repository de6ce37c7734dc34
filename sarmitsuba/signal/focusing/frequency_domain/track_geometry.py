"""Geometry of data and image along a straight track, and the Doppler band that they need."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sarmitsuba.core.arrays import F64, I64
from sarmitsuba.radar.radar import Radar
from sarmitsuba.signal.focusing.aperture_weights import direction_gain, look_directions
from sarmitsuba.signal.focusing.frequency_domain.equivalent_track import LARGEST_PHASE, EquivalentTrack
from sarmitsuba.signal.focusing.frequency_domain.turning import lit_from_orbit, range_blocks, turns
from sarmitsuba.signal.focusing.grid import slant_below, slant_ranges
from sarmitsuba.signal.image import ImageGrid

# largest part of the (raised) PRF that the image's Doppler band may take: the rest is for the ripple at its edges
_BAND_FILL = 0.6

# two-way amplitude, over the strongest at the same pixel, above which a pulse counts for the image's Doppler band
_LIT = 0.02
# pulses sampled for that
_PULSES = 256
# least processed half band over half the pixels' own apertures: margin for the tails of their ends
_TAILS = 3.0
# largest sine that an aperture may reach: along the track no pixel has a range of its own
_STEEPEST = 0.99
# Fresnel widths beyond the image's last direction over which the matched filter fades out
_FADE = 8.0


@dataclass(frozen=True, eq=False)
class TrackGeometry:
    """Positions of data and image along a straight track, and the Doppler band.

    Parameters
    ----------
    x : (n_pulses,) float64, m, pulse positions from the grid's origin
    spacing : m between pulses
    x_center, rho_center : m, azimuth and closest-approach range of the image's central pixel
    range_center : m, slant range from the middle of that pixel's aperture to it
    sin_squint : sine of the angle between that line of sight and broadside: the middle of the image's Doppler band
    half_band : half the Doppler band of a pixel's aperture, in sines; infinite where all pulses serve every pixel
    seen : smallest and largest sine at which pulses see the image; within the beam, or the pixels' apertures
    faded : beyond those, sines at which the matched filter has faded out
    """

    x: F64
    spacing: float
    x_center: float
    rho_center: float
    range_center: float
    sin_squint: float
    half_band: float
    seen: tuple[float, float]
    faded: tuple[float, float]

    @property
    def cosine(self) -> float:
        """Cosine of the squint."""
        return float(np.sqrt(max(1.0 - self.sin_squint**2, 0.0)))

    def nyquist(self, wavenumber: float) -> float:
        """Half the Doppler band that the pulses sample at a wavenumber, rad/m, in sines."""
        return float(np.pi / (self.spacing * wavenumber))

    def reach(self, wavenumber: float) -> float:
        """Half the processed band about the squint at a wavenumber, rad/m, in sines, within :attr:`faded`.

        It is that of the pulses; where pixels' apertures with the tails of their ends are wider, the pulses'
        spectrum is continued periodically.
        """
        pulses = self.nyquist(wavenumber)
        return max(pulses, _TAILS * self.half_band) if np.isfinite(self.half_band) else pulses

    def sines(self, wavenumber: float) -> F64:
        """Smallest and largest processed sine at a wavenumber, rad/m, (2,) float64.

        Pulses closer than half of ``wavelength / 2`` sample sines past 1, where nothing is: the image's directions are
        the bound, not the pulse rate.
        """
        reach = self.reach(wavenumber)
        return np.clip(self.sin_squint + np.array([-reach, reach]), *self.faded)

    def fade(self, sine: F64) -> F64 | None:
        """Weight of the matched filter at sines: 1 within :attr:`seen`, falling to 0 at :attr:`faded`; None for 1."""
        if sine.min() >= self.seen[0] and sine.max() <= self.seen[1]:
            return None
        width = [max(abs(end - edge), 1e-12) for edge, end in zip(self.seen, self.faded, strict=True)]
        beyond = np.maximum(
            (self.seen[0] - sine) * (1.0 / width[0]), (sine - self.seen[1]) * (1.0 / width[1])
        )
        return np.asarray(np.cos(0.5 * np.pi * np.clip(beyond, 0.0, 1.0)) ** 2)


def slant_grid(radar: Radar, grid: ImageGrid) -> ImageGrid:
    """Slant grid on which the data are focused."""
    return slant_below(radar, grid) if grid.kind == "ground" else grid


def track_refusal(radar: Radar, grid: ImageGrid) -> str:
    """Reason why a frequency-domain focuser cannot focus a radar's data on a grid; empty when it can."""
    track = radar.track
    if track.n_pulses < 8:
        return f"{track.n_pulses} pulses are too few, at least 8 are needed"
    if not track.is_straight:
        return curve_refusal(radar, grid)
    ground = grid.kind == "ground"
    relative = track.position - (track.center_position if ground else grid.origin)
    off = np.abs(relative - (relative @ grid.along)[:, None] * grid.along).max()
    if off > 1e-4 or (track.position[-1] - track.position[0]) @ grid.along < 0.0:
        return f"the track runs {off:.3g} m off the {grid.kind} grid's horizontal axis (bound 1e-4 m)"
    edge = abs(boresight_sine(radar)) + radar.half_aperture
    if own_apertures(radar) and not turns(radar) and edge > _STEEPEST:
        return (
            f"the pixels' apertures reach {np.degrees(np.arcsin(min(edge, 1.0))):.3g} degrees off broadside (bound "
            f"{np.degrees(np.arcsin(_STEEPEST)):.3g})"
        )
    if ground and slant_ranges(radar, grid).min() <= 0.0:
        return "the ground grid reaches across the ground track"
    return ""


def curve_refusal(radar: Radar, grid: ImageGrid) -> str:
    """Reason why data from a curved track cannot be focused on a grid; empty when an equivalent straight one serves."""
    track = radar.track
    step = np.diff(track.time)
    if not lit_from_orbit(radar) or np.ptp(step) > 1e-6 * step.mean():
        return "the track is curved or not uniformly sampled"
    if radar.antenna.table is not None:
        return "the antenna's pattern is a table, which is not stretched to the effective velocity in orbit"
    worst = max(EquivalentTrack.of(radar, block).phase for block in range_blocks(radar, grid))
    if worst > LARGEST_PHASE:
        return (
            f"the effective velocity in orbit changes over the image, which leaves {worst:.3g} rad (bound "
            f"{LARGEST_PHASE:g})"
        )
    return ""


def own_apertures(radar: Radar) -> bool:
    """Whether every pixel has its own aperture, a band about the boresight's direction."""
    return bool(np.isfinite(radar.half_aperture))


def lit_in_turn(radar: Radar) -> bool:
    """Whether the beam, or the band of the pixels' apertures, passes over the pixels one after the other."""
    return own_apertures(radar) or (radar.antenna.directive and radar.mode_law.own_apertures)


def track_geometry(radar: Radar, grid: ImageGrid) -> TrackGeometry:
    """Positions of data and image along a straight track, and the Doppler band.

    The middle of the Doppler band is the direction to the image's centre from the middle of the pulses that serve it:
    in spotlight those of the whole track. Pixels' apertures lie about the boresight, wherever along the strip the
    image is.
    """
    track = radar.track
    spacing = float(np.linalg.norm((track.position[-1] - track.position[0]) / (track.n_pulses - 1)))
    x = (track.position - grid.origin) @ grid.along
    x_center = float(grid.azimuth[grid.azimuth.size // 2])
    rho = float(grid.range[grid.range.size // 2])
    middle = 0.5 * (x[0] + x[-1])
    if own_apertures(radar):
        middle = x_center - float(_way_back(rho, boresight_sine(radar)))
    elif lit_in_turn(radar):
        middle = x_center - float(_way_back(rho, _middle_sine(radar, grid)))
    distance = float(np.hypot(x_center - middle, rho))
    squint = (x_center - middle) / distance
    seen = _seen_sines(radar, grid, x, squint)
    faded = _faded_sines(radar, grid, seen)
    return TrackGeometry(x, spacing, x_center, rho, distance, squint, radar.half_aperture, seen, faded)


def _seen_sines(radar: Radar, grid: ImageGrid, x: F64, squint: float) -> tuple[float, float]:
    """Smallest and largest sine at which pulses at ``x`` (n_pulses,), m along the grid, see the image."""
    if own_apertures(radar):
        return max(squint - radar.half_aperture, -1.0), min(squint + radar.half_aperture, 1.0)
    if lit_in_turn(radar):
        sine, lit = lit_sines(radar, grid)
        sine = sine[lit] if lit.any() else sine
    else:
        ahead = np.array([grid.azimuth[0] - x.max(), grid.azimuth[-1] - x.min()])[:, None]
        sine = ahead / np.hypot(ahead, grid.range[[0, -1]])
    return float(sine.min()), float(sine.max())


def _faded_sines(radar: Radar, grid: ImageGrid, seen: tuple[float, float]) -> tuple[float, float]:
    r"""Sines at which the matched filter has faded out, some Fresnel widths beyond those that see the image.

    A filter cut at a direction is wrong, by Fresnel's ripple, within some widths of

    .. math:: \Delta s = (1 - s^2)^{3/4} \sqrt{\pi / k \rho}

    of it. No farther than halfway to grazing, where it would raise the leakage by :math:`(k / k_y)^{7/2}`.
    Pixels' apertures end by tails of their own, which reach as far.
    """
    rho, ends = float(grid.range[0]), []
    for sign, sine in zip((-1.0, 1.0), seen, strict=True):
        away = max(1.0 - sign * sine, 0.0)  # to grazing
        width = _FADE * (1.0 - sine**2) ** 0.75 * np.sqrt(np.pi / (wavenumber(radar) * rho))
        ends.append(sine + sign * (0.9 * away if own_apertures(radar) else min(width, 0.5 * away)))
    return ends[0], ends[1]


def _way_back(rho: ArrayLike, sine: float) -> F64:
    """Along-track distance, m, from the position that sees a pixel at a given sine to its closest approach."""
    return np.asarray(np.asarray(rho) * (sine / np.sqrt(1.0 - sine**2)), dtype=np.float64)


def _middle_sine(radar: Radar, grid: ImageGrid) -> float:
    """Middle of the sines at which the beam over the track illuminates the image's corners, edges and middle."""
    sine, lit = lit_sines(radar, grid)
    return 0.5 * float(sine[lit].min() + sine[lit].max()) if lit.any() else boresight_sine(radar)


def lit_sines(radar: Radar, grid: ImageGrid) -> tuple[F64, NDArray[np.bool_]]:
    """Sines at which sampled pulses see the image's corners, edges and middle, (3, 3, n), and which of them count."""
    rows, columns = (axis[[0, axis.size // 2, -1]] for axis in (grid.azimuth, grid.range))
    step = max(1, radar.track.n_pulses // _PULSES)
    look = look_directions(radar, replace(grid, azimuth=rows, range=columns).positions())[..., ::step, :]
    gain = direction_gain(radar, slice(None, None, step), look)
    lit = gain > _LIT * gain.max(axis=-1, keepdims=True, initial=1e-300)
    return np.asarray(look @ grid.along), np.asarray(lit)


def aperture_middle(radar: Radar, geometry: TrackGeometry, azimuth: F64, rho: F64) -> I64:
    """Nearest pulse to the middle of the pixels' apertures; arguments broadcast, m."""
    middle = 0.5 * (geometry.x[0] + geometry.x[-1])
    if lit_in_turn(radar):
        middle = azimuth - _way_back(rho, geometry.sin_squint)
    pulse = np.rint((middle - geometry.x[0]) / geometry.spacing)
    return np.asarray(np.clip(pulse, 0, geometry.x.size - 1).astype(np.int64))


def rate_factor(radar: Radar, grid: ImageGrid, geometry: TrackGeometry) -> tuple[int, float]:
    """Integer factor on the pulse rate with which the image's Doppler band fits, with margin for ripple at its edges.

    Raising the rate needs the echoes deramped to the image's centre first, which must itself fit the PRF: it does in
    spotlight geometry, where the aperture, not the image, makes the band.

    Returns
    -------
    factor, and the band over the raised rate: above 1 the image is aliased nevertheless
    """
    if own_apertures(radar):  # their whole band is processed, see TrackGeometry.reach
        return 1, min(radar.half_aperture / geometry.reach(wavenumber(radar)), 1.0)
    highest = wavenumber(radar) * (1.0 + 0.5 * radar.waveform.bandwidth / radar.waveform.center_frequency)
    corners = (
        replace(grid, azimuth=grid.azimuth[[0, -1]], range=grid.range[[0, -1]]).positions().reshape(4, 3)
    )
    step = max(1, radar.track.n_pulses // 256)
    look = look_directions(radar, corners)[:, ::step]
    center = np.hypot(geometry.x - geometry.x_center, geometry.rho_center)
    sin = look @ grid.along
    seen = direction_gain(radar, slice(None, None, step), look) > _LIT
    nyquist = geometry.nyquist(highest)
    band = float(np.abs(sin - geometry.sin_squint)[seen].max(initial=0.0)) / nyquist
    deramped = sin - ((geometry.x_center - geometry.x) / center)[::step]
    if float(np.abs(deramped)[seen].max(initial=0.0)) / nyquist < 0.95:
        factor = max(1, int(np.ceil(band / _BAND_FILL)))
        return factor, band / factor
    return 1, band


def range_walk(radar: Radar, grid: ImageGrid, geometry: TrackGeometry) -> int:
    """Range walk of the echoes of one Doppler frequency against the receive window over the aperture, in samples.

    A frequency belongs to one pulse, and its echoes move with the range to the image's centre; where pixels are
    illuminated one after the other it belongs to all pulses that serve the image, and the echoes move with the receive
    window.
    """
    start = radar.window.start_range
    if lit_in_turn(radar):
        first, last = serving_pulses(radar, grid, geometry)
        walk = start[first : last + 1]
    else:
        walk = np.hypot(geometry.x - geometry.x_center, geometry.rho_center) - start
    return int(np.ceil((walk.max() - walk.min()) / radar.window.sample_spacing))


def serving_pulses(radar: Radar, grid: ImageGrid, geometry: TrackGeometry) -> tuple[int, int]:
    """First and last pulse that lie in the aperture of some pixel."""
    if own_apertures(radar):
        edge = geometry.sin_squint + radar.half_aperture * np.array([1.0, -1.0])
    elif lit_in_turn(radar):
        sine, lit = lit_sines(radar, grid)
        edge = np.array([sine[lit].max(initial=-_STEEPEST), sine[lit].min(initial=_STEEPEST)])
    else:
        return 0, geometry.x.size - 1
    ends = grid.azimuth[[0, -1], None] - [[_way_back(rho, s) for rho in grid.range[[0, -1]]] for s in edge]
    first, last = np.rint((np.array([ends.min(), ends.max()]) - geometry.x[0]) / geometry.spacing)
    most = geometry.x.size - 1
    return int(np.clip(first, 0, most)), int(np.clip(last, 0, most))


def track_period(radar: Radar, grid: ImageGrid, geometry: TrackGeometry) -> float:
    """Least period of the azimuth transform, m.

    It contains data, image and the matched filter of the processed band; the filter connects a pixel with the pulses
    that see it within that band, or within its own aperture.
    """
    return float(np.ptp(geometry.x)) + filter_overhang(radar, grid, geometry) + 32.0 * geometry.spacing


def filter_overhang(radar: Radar, grid: ImageGrid, geometry: TrackGeometry) -> float:
    """Largest extent of a pixel's matched filter beyond the farther end of the track, m."""
    lowest = wavenumber(radar) * (1.0 - 0.5 * radar.waveform.bandwidth / radar.waveform.center_frequency)
    half = min(geometry.reach(lowest), _TAILS * geometry.half_band)
    edge = np.clip(geometry.sin_squint + np.array([-half, half]), *geometry.faded)
    reach = grid.range[[0, -1], None] * np.tan(np.arcsin(edge))  # pixel minus pulse
    data, pixels = geometry.x[[0, -1]], grid.azimuth[[0, -1]]
    return float(max(pixels[-1] - reach.min() - data[1], data[0] - pixels[0] + reach.max(), 0.0))


def boresight_sine(radar: Radar) -> float:
    """Sine of the boresight along the flight, the same for all pulses in stripmap on a straight track."""
    middle = radar.track.center_index
    return float(radar.pointing.boresight[middle] @ radar.track.along)


def wavenumber(radar: Radar) -> float:
    """k_c, two-way wavenumber at the centre frequency, rad/m."""
    return 4.0 * np.pi / radar.waveform.wavelength
