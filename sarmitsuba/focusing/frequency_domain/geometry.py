"""Where the data and the image stand along a straight track, and what of the spectrum they need."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from sarmitsuba.focusing.aperture import direction_gain, look_directions
from sarmitsuba.focusing.ground import slant_below, slant_ranges
from sarmitsuba.image.sar_image import ImageGrid
from sarmitsuba.radar.radar import Radar

F64 = NDArray[np.float64]

# largest part of the (raised) PRF that the image's Doppler band may take: the rest is for the ripple at its edges
_BAND_FILL = 0.6

# change of the boresight's sine over the track up to which a beam counts as fixed to it: rounding
_FIXED = 1e-9


@dataclass(frozen=True, eq=False)
class TrackGeometry:
    """Where the data and the image stand along the track's line.

    Parameters
    ----------
    x : (n_pulses,) float64, m, pulse positions from the grid's origin
    spacing : m between pulses
    x_center, rho_center : m, azimuth and closest-approach range of the image's central pixel
    range_center : m, slant range from mid-aperture to the central pixel
    sin_squint : sine of the angle between that line of sight and broadside
    """

    x: F64
    spacing: float
    x_center: float
    rho_center: float
    range_center: float
    sin_squint: float

    @property
    def cosine(self) -> float:
        """Cosine of the squint."""
        return float(np.sqrt(max(1.0 - self.sin_squint**2, 0.0)))


def slant_grid(radar: Radar, grid: ImageGrid) -> ImageGrid:
    """Where the focusing itself takes place."""
    return slant_below(radar, grid) if grid.kind == "ground" else grid


def track_refusal(radar: Radar, grid: ImageGrid) -> str:
    """What keeps a frequency-domain focuser from focusing a radar's data on a grid; empty when nothing does."""
    track = radar.track
    if track.n_pulses < 8:
        return f"{track.n_pulses} pulses are too few, at least 8 are needed"
    if not track.is_straight:
        return "the track is curved or not uniformly sampled"
    ground = grid.kind == "ground"
    relative = track.position - (track.center_position if ground else grid.origin)
    off = np.abs(relative - (relative @ grid.along)[:, None] * grid.along).max()
    if off > 1e-4 or (track.position[-1] - track.position[0]) @ grid.along < 0.0:
        return f"the track runs {off:.3g} m off the {grid.kind} grid's horizontal axis (bound 1e-4 m)"
    turns = float(np.ptp(radar.pointing.boresight @ radar.track.along))
    if radar.antenna.pattern != "isotropic" and radar.mode_law.own_apertures and turns > _FIXED:
        return "the beam turns over the track (sliding spotlight, orbit), so that pixels' apertures differ in Doppler"
    if ground and slant_ranges(radar, grid).min() <= 0.0:
        return "the ground grid reaches across the ground track"
    return ""


def track_geometry(radar: Radar, grid: ImageGrid) -> TrackGeometry:
    """Where the data and the image stand along the track's line."""
    track = radar.track
    spacing = float(np.linalg.norm((track.position[-1] - track.position[0]) / (track.n_pulses - 1)))
    x = (track.position - grid.origin) @ grid.along
    x_center = float(grid.azimuth[grid.azimuth.size // 2])
    rho = float(grid.range[grid.range.size // 2])
    middle = 0.5 * (x[0] + x[-1])
    distance = float(np.hypot(x_center - middle, rho))
    return TrackGeometry(x, spacing, x_center, rho, distance, (x_center - middle) / distance)


def rate_factor(radar: Radar, grid: ImageGrid, geometry: TrackGeometry) -> tuple[int, float]:
    """Whole factor on the pulse rate so that the whole image's Doppler band fits with room for its edges' ripple.

    Raising the rate needs the echoes deramped to the image's centre first, which must itself fit the PRF: it does in
    spotlight geometry, where the aperture, not the image, makes the band.

    Returns
    -------
    factor, and the band over the raised rate: past 1 the image folds over all the same
    """
    corners = (
        replace(grid, azimuth=grid.azimuth[[0, -1]], range=grid.range[[0, -1]]).positions().reshape(4, 3)
    )
    step = max(1, radar.track.n_pulses // 256)
    look = look_directions(radar, corners)[:, ::step]
    center = np.hypot(geometry.x - geometry.x_center, geometry.rho_center)
    sin = look @ grid.along
    own = np.isfinite(radar.half_aperture)
    # pixels with apertures of their own: the beam's side lobes fold over, as in any stripmap radar
    seen = direction_gain(radar, slice(None, None, step), look) > (0.05 if own else 0.02)
    nyquist = np.pi / geometry.spacing / (4.0 * np.pi / radar.waveform.wavelength)  # in sin(angle)
    band = float(np.abs(sin - geometry.sin_squint)[seen].max(initial=0.0)) / nyquist
    deramped = sin - ((geometry.x_center - geometry.x) / center)[::step]
    if own:  # what folds must stay out of the band that is processed, nothing more
        extent = np.abs(sin - boresight_sine(radar))[seen].max(initial=0.0) + radar.half_aperture
        band = 0.5 * float(extent) / nyquist
        if band < 1.0:
            return 1, band
    if float(np.abs(deramped)[seen].max(initial=0.0)) / nyquist < 0.95:
        factor = max(1, int(np.ceil(band / _BAND_FILL)))
        return factor, band / factor
    return 1, band


def range_walk(radar: Radar, geometry: TrackGeometry) -> int:
    """Samples by which the range to the image's centre moves against the receive window over the aperture."""
    r = np.hypot(geometry.x - geometry.x_center, geometry.rho_center) - radar.window.start_range
    return int(np.ceil((r.max() - r.min()) / radar.window.sample_spacing))


def track_period(radar: Radar, grid: ImageGrid, geometry: TrackGeometry) -> float:
    """Length of track, m, over which the azimuth transform must not repeat itself.

    Data, image and the matched filter of full PRF bandwidth, each with its own extent; the filter ties a pixel to the
    pulses that see it within half the PRF of the centre's Doppler frequency.
    """
    k = 4.0 * np.pi / radar.waveform.wavelength
    edge = np.clip(
        geometry.sin_squint + np.array([-1.0, 1.0]) * np.pi / (geometry.spacing * k), -0.999, 0.999
    )
    reach = grid.range[-1] * np.tan(np.arcsin(edge))  # pixel minus pulse
    data = geometry.x[[0, -1]]
    pixels = grid.azimuth[[0, -1]]
    # farthest that any pixel's filter reaches beyond the farther end of the data
    low = min(pixels[0] - reach[1], data[0])
    high = max(pixels[-1] - reach[0], data[1])
    return float(max(high - data[0], data[1] - low)) + 32.0 * geometry.spacing


def boresight_sine(radar: Radar) -> float:
    """Sine of the beam along the flight, the same for all pulses of a straight track's stripmap."""
    middle = radar.track.center_index
    return float(radar.pointing.boresight[middle] @ radar.track.along)


__all__ = [
    "TrackGeometry",
    "boresight_sine",
    "range_walk",
    "rate_factor",
    "slant_grid",
    "track_geometry",
    "track_period",
    "track_refusal",
]
