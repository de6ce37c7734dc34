"""Echoes of drawn radars and points, and their image by a direct sum that shares no code with the focusers."""

from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from sarmitsuba.core.arrays import C128, F64
from sarmitsuba.core.constants import SPEED_OF_LIGHT
from sarmitsuba.core.errors import SarmitsubaError
from sarmitsuba.loading.build import build_scene
from sarmitsuba.radar.antenna import Antenna
from sarmitsuba.radar.description import RadarDescription
from sarmitsuba.radar.film import FilmDescription
from sarmitsuba.radar.image_request import ImageRequest
from sarmitsuba.radar.mode import MODES, AimGeometry
from sarmitsuba.radar.radar import Radar, ReceiveWindow
from sarmitsuba.radar.track import Track
from sarmitsuba.scene.geometry import PointTarget
from sarmitsuba.signal.focusing import default_grid
from sarmitsuba.signal.focusing.ideal import ideal_echoes, ideal_radar
from sarmitsuba.signal.focusing.profiles import plan_spectrum
from sarmitsuba.signal.focusing.windows import parse_window
from sarmitsuba.signal.image import ImageGrid
from sarmitsuba.signal.raw_data import RawData

CARRIERS = {"L": 1.3e9, "C": 5.4e9, "X": 9.6e9, "Ku": 16e9}
MARGIN = 12  # pixels from the image's ends to the outermost points
# pixels times pulses of a case: a second for a reference of its best kernel
MOST_WORK = 2e7
# modes, and how many of ten draws have them
DRAWN_MODES = ("spotlight",) * 4 + ("stripmap",) * 3 + ("sliding_spotlight",) * 2 + ("circular",)
WINDOWS = ("rectangular",) * 5 + ("hamming", "taylor:4:-35", "kaiser:2.5")


@dataclass(frozen=True, eq=False)
class DrawnEchoes:
    """A case: what was recorded, the image to make of it, and the windows that it is made with."""

    raw: RawData
    grid: ImageGrid
    range_window: str
    azimuth_window: str
    label: str


def draw_echoes(seed: int) -> DrawnEchoes:
    """Mode, band, geometry, track, image and scatterers drawn by seed; draws that make no image are drawn again."""
    for attempt in range(100):
        rng = np.random.default_rng([seed, attempt, 0x5E])
        try:
            made = _draw(rng)
        except SarmitsubaError:  # the image lies under the track, or outside of the beam
            continue
        if made is not None:
            return made
    raise AssertionError(f"seed {seed}: no draw makes an image")


def _chance(rng: np.random.Generator, probability: float) -> bool:
    return bool(rng.random() < probability)


def _draw(rng: np.random.Generator) -> DrawnEchoes | None:
    mode = DRAWN_MODES[rng.integers(len(DRAWN_MODES))]
    band = str(rng.choice(list(CARRIERS)))
    far = _chance(rng, 0.15)
    slant_range = 700e3 if far else float(np.exp(rng.uniform(np.log(2e3), np.log(30e3))))
    # an aperture of 0.01 to 0.06 rad
    wavelength = SPEED_OF_LIGHT / CARRIERS[band]
    resolution = float(np.clip(0.5 * wavelength / np.exp(rng.uniform(np.log(0.01), np.log(0.06))), 0.5, 8.0))
    cell = float(resolution * np.exp(rng.uniform(np.log(0.5), np.log(1.5))))
    squint = float(rng.uniform(-20.0, 20.0)) if mode != "circular" and _chance(rng, 0.5) else 0.0
    radar = RadarDescription(
        mode=mode,
        slant_range=slant_range,
        look_angle_deg=float(rng.uniform(20.0, 65.0)),
        heading_deg=float(rng.uniform(0.0, 360.0)),
        look_side=("left", "right")[rng.integers(2)],
        squint_angle_deg=squint,
        center_frequency=CARRIERS[band],
        bandwidth=0.5 * SPEED_OF_LIGHT / cell,
        speed=7500.0 if far else 100.0,
        prf_jitter=float(rng.uniform(0.0, 0.01)) if _chance(rng, 0.15) else 0.0,
        **_beam(rng, resolution, wavelength),
    )
    if mode == "circular":
        radar = replace(radar, mode_parameters={"arc_deg": float(np.degrees(0.5 * wavelength / resolution))})
    else:
        radar = replace(radar, azimuth_resolution=resolution)
    sides = [float(rng.uniform(40.0, 90.0)) * r for r in (resolution, cell)]
    shift = rng.uniform(-0.5, 0.5, 2) * max(sides) * _chance(rng, 0.4)
    film = FilmDescription(
        image_grid=("slant", "ground")[rng.integers(2)],
        image_extent_azimuth=sides[0],
        image_extent_range=sides[1],
        image_center_x=float(shift[0]),
        image_center_y=float(shift[1]),
        sampling_rate=float(rng.uniform(1.02, 1.6)) * radar.bandwidth,
    )
    aim = [PointTarget("aim", np.zeros(3), 1.0)]
    scene = build_scene(points=aim, radar=radar, film=film)
    if _chance(rng, 0.3):
        prf = (scene.radar.track.n_pulses - 1) / float(np.ptp(scene.radar.track.time))
        scene = build_scene(
            points=aim, radar=replace(radar, prf=prf * float(rng.uniform(0.8, 1.6))), film=film
        )
    there, grid = scene.radar, default_grid(scene.radar, scene.image)
    if (
        np.prod(grid.shape) * there.track.n_pulses > MOST_WORK
        or there.track.n_pulses < 20
        or min(grid.shape) < 40
    ):
        return None
    wander = 10.0 ** rng.uniform(-3.0, 0.5) if _chance(rng, 0.4) else 0.0
    if wander:
        there = _wandering(there, wander, rng)
    points, strengths = _points(grid, resolution, rng)
    raw = ideal_echoes(there, points, strengths, rng.uniform(0.0, 2.0 * np.pi, len(points)))
    text = f"{mode} {band} {radar.pattern} {slant_range / 1e3:.0f} km squint {squint:.0f} {film.image_grid}"
    text += f" {there.track.n_pulses} pulses wander {wander:.2g} m" + " off centre" * bool(shift.any())
    return DrawnEchoes(
        raw,
        grid,
        WINDOWS[rng.integers(len(WINDOWS))],
        WINDOWS[rng.integers(len(WINDOWS))],
        text + " uneven" * (radar.prf_jitter > 0.0),
    )


# ---------------------------------------------------------------- outside of what laws were fitted on

# Hz, m, pulses a wavelength, and the product of aperture and Doppler bandwidth: ranges of their logarithms
FREQUENCY, DISTANCE, DENSITY, PRODUCT = (30e6, 240e9), (0.3, 900e3), (1.0, 10.0), (5.0, 2000.0)
WIDE_MODES = ("spotlight",) * 4 + ("beam",) * 2 + ("own",) * 4
MOST_PULSES, MOST_SAMPLES = 3000, 1500


def draw_wide(seed: int) -> DrawnEchoes:
    """A straight track of 1 to 10 pulses a wavelength, 30 MHz to 240 GHz, 0.3 m to 900 km, by seed.

    Apertures to 70 deg, beams to 40 deg, squints to 40 deg, bandwidths to that of the carrier.
    """
    for attempt in range(1000):
        made = None
        with suppress(SarmitsubaError):
            made = _draw_wide(np.random.default_rng([seed, attempt, 0xA7]))
        if made is not None:
            return made
    raise AssertionError(f"seed {seed}: no draw makes an image")


def _between(rng: np.random.Generator, low: float, high: float) -> float:
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def _draw_wide(rng: np.random.Generator) -> DrawnEchoes | None:
    mode = WIDE_MODES[rng.integers(len(WIDE_MODES))]
    frequency = _between(rng, *FREQUENCY)
    wavelength = SPEED_OF_LIGHT / frequency
    slant_range = _between(rng, max(DISTANCE[0], 3.0 * wavelength), DISTANCE[1])
    squint = np.radians(rng.uniform(-40.0, 40.0)) if _chance(rng, 0.4) else 0.0
    angle = float(np.sqrt(0.5 * _between(rng, *PRODUCT) * wavelength / slant_range))
    if angle > 1.2 or abs(np.sin(squint)) + 0.5 * angle > 0.95:
        return None
    most = MOST_PULSES * wavelength / (angle * slant_range)
    density = min(max(_between(rng, *DENSITY), 2.4 * angle), most)
    if density < 2.3 * angle:
        return None
    bandwidth = frequency * _between(rng, 0.003, 0.9)
    cells = 0.5 * wavelength / angle, 0.5 * SPEED_OF_LIGHT / bandwidth
    sides = [float(rng.uniform(20.0, 40.0)) * cell for cell in cells]
    if max(sides) > 0.6 * slant_range:
        return None
    width = min(angle * float(rng.uniform(0.7, 2.0)), np.radians(40.0))
    antenna = Antenna()
    if mode == "beam" or _chance(rng, 0.4):
        pattern = ("gaussian", "rectangular")[rng.integers(2)]
        antenna = Antenna(pattern, 1.0, width, np.radians(rng.uniform(10.0, 40.0)))
    radar = ideal_radar(
        slant_range=slant_range,
        resolution=cells[0],
        bandwidth=bandwidth,
        center_frequency=frequency,
        look_angle=np.radians(rng.uniform(25.0, 60.0)),
        squint_angle=squint,
        prf_factor=0.5 * density / angle,
        sampling_factor=float(rng.uniform(1.02, 1.6)),
        antenna=antenna,
        mode="spotlight" if mode == "spotlight" else "stripmap",
    )
    if mode != "spotlight":
        half = 0.5 * angle if mode == "own" else np.inf
        radar = _along_strip(
            radar, sides[0] + 1.2 * slant_range * (angle if mode == "own" else 2.5 * width), half
        )
    sample, position = radar.window.sample_spacing, radar.track.position
    corners = np.array([[0.5 * a * sides[1], 0.5 * b * sides[0], 0.0] for a in (-1.3, 1.3) for b in (-1, 1)])
    distance = np.linalg.norm(position, axis=1)
    if mode == "spotlight":
        span = max(
            float(np.abs(np.linalg.norm(corner - position, axis=1) - distance).max()) for corner in corners
        )
        start, n_samples = np.floor((distance - span) / sample - 20) * sample, int(2.0 * span / sample) + 40
    else:
        nearest = (
            np.floor((np.linalg.norm(corners[:, None] - position, axis=-1).min()) / sample - 20) * sample
        )
        farthest = slant_range * (1.0 + 0.5 * angle**2 + 2.0 * angle * abs(np.tan(squint))) + sides[1]
        start = np.full(distance.size, nearest)
        n_samples = int((farthest - nearest) / sample) + 40
    if n_samples > MOST_SAMPLES or distance.size > 2 * MOST_PULSES or distance.size < 20 or start.min() < 0.0:
        return None
    radar = replace(radar, window=ReceiveWindow(start, sample, n_samples))
    kind = ("slant", "ground")[rng.integers(2)]
    request = ImageRequest(kind, 0.0, 0.0, 0.0, sides[0], sides[1], 0.0, 0.0)
    grid = default_grid(radar, request)
    if np.prod(grid.shape) * distance.size > MOST_WORK or min(grid.shape) < 16:
        return None
    wander = (
        float(wavelength * _between(rng, 0.01, 3.0)) if mode == "spotlight" and _chance(rng, 0.2) else 0.0
    )
    flown = _wandering(radar, wander, rng) if wander else radar
    points, strengths = _points(grid, cells[0], rng)
    keep = slice(0, 24)
    raw = ideal_echoes(flown, points[keep], strengths[keep], rng.uniform(0.0, 2.0 * np.pi, len(points[keep])))
    text = (
        f"{mode} {antenna.pattern} {frequency / 1e9:.3g} GHz {slant_range:.3g} m aperture {np.degrees(angle):.2g} deg "
        f"squint {np.degrees(squint):.0f} band {100.0 * bandwidth / frequency:.2g} % {density:.2g} pulses/wavelength "
        f"{distance.size} pulses {kind} wander {wander:.2g} m"
    )
    return DrawnEchoes(
        raw, grid, WINDOWS[rng.integers(len(WINDOWS))], WINDOWS[rng.integers(len(WINDOWS))], text
    )


def _along_strip(radar: Radar, length: float, half_aperture: float) -> Radar:
    """The radar in stripmap over a track of a length, m, each pixel with its own aperture."""
    track = radar.track
    spacing = float(np.linalg.norm(track.position[1] - track.position[0]))
    center, n = track.center_position, max(20, round(length / spacing))
    longer = Track.straight(center, track.velocity[0], track.prf, n)
    geometry = AimGeometry(np.zeros(3), center, np.array([0.0, 1.0, 0.0]), np.array([1.0, 0.0, 0.0]))
    pointing = MODES["stripmap"].pointing(longer, geometry)
    window = ReceiveWindow(np.zeros(n), radar.window.sample_spacing, 1)
    return replace(radar, track=longer, pointing=pointing, window=window, half_aperture=half_aperture)


def _beam(rng: np.random.Generator, resolution: float, wavelength: float) -> dict[str, Any]:
    kind = ("isotropic", "rectangular", "gaussian")[rng.integers(3)]
    if kind == "rectangular":
        return {
            "pattern": kind,
            "antenna_length": float(rng.uniform(1.5, 3.0)) * resolution,
            "antenna_height": float(rng.uniform(0.05, 0.3)),
        }
    if kind == "gaussian":
        width = float(np.degrees(0.5 * wavelength / resolution)) * float(rng.uniform(0.7, 2.0))
        elevation = float(rng.uniform(8.0, 30.0))
        return {"pattern": kind, "azimuth_beamwidth_deg": width, "elevation_beamwidth_deg": elevation}
    return {"pattern": kind}


def _wandering(radar: Radar, wander: float, rng: np.random.Generator) -> Radar:
    """The track off its line by up to ``wander``, m, by slow sines in all three directions."""
    track = radar.track
    phase = np.linspace(0.0, 2.0 * np.pi, track.n_pulses)
    sway = sum(
        rng.normal(size=3) * np.sin(k * phase[:, None] + rng.uniform(0.0, 6.28, 3)) / k
        for k in (0.5, 1, 2, 3)
    )
    position = track.position + wander * sway / np.abs(sway).max()
    return replace(radar, track=Track(track.time, position, np.gradient(position, track.time, axis=0)))


def _points(grid: ImageGrid, cell: float, rng: np.random.Generator) -> tuple[F64, F64]:
    """Places at the image's middle and edges, of a cloud all over it, and beyond it; (n, 3) m, and their RCS."""
    n = np.array(grid.shape)
    m = np.minimum(MARGIN, n // 4)
    places = [n // 2, [m[0], n[1] - m[1]], [n[0] - m[0], m[1]], rng.integers(m, n - m)]
    if _chance(rng, 0.5):
        places += list(rng.integers(0, n, (80, 2)))
    beyond = _chance(rng, 0.3)
    if beyond:  # a scene does not end where the image does; farther along the track the pulse rate folds it
        places += list((rng.uniform([-0.1, -0.3], [1.1, 1.3], (40, 2)) * n).astype(int))
    points = []
    height = 20.0 * cell * rng.random() * _chance(rng, 0.4)  # of houses
    for row, column in places:
        one = replace(
            grid,
            azimuth=grid.azimuth[0] + np.array([row + rng.uniform(-0.5, 0.5)]) * grid.azimuth_spacing,
            range=grid.range[0] + np.array([column + rng.uniform(-0.5, 0.5)]) * grid.range_spacing,
        )
        points.append(one.positions()[0, 0] + [0.0, 0.0, height * rng.random()])
    return np.array(points), rng.uniform(0.5, 2.0, len(points))


# ---------------------------------------------------------------- the direct sum


def direct_sum(raw: RawData, points: F64) -> C128:
    r"""Pixels at (n, 3) points, every pulse summed at its own exact range, float64: (n_layers, n).

    Between samples a pulse is the Fourier series of the radar's band through them and the zeros of the guard that
    follows them: what backprojection is documented to sum. Rectangular windows.
    """
    radar = raw.radar
    window = radar.window
    n = plan_spectrum(radar, parse_window("rectangular")).n_fft  # samples and guard
    bins = np.arange(-(n // 2), n - n // 2)
    half = 0.5 * n * window.sample_spacing / radar.waveform.range_cell
    share = np.clip(half - np.abs(bins) + 0.5, 0.0, 1.0) if 2.0 * half < n else np.ones(n)
    used = share > 0.0
    bins, share = bins[used], share[used]
    sample = np.arange(window.n_samples) - window.n_samples // 2
    transform = share * np.exp(-2j * np.pi / n * np.outer(sample + window.n_samples // 2, bins))
    # a point amid the window keeps its peak
    amid = np.sinc(sample * window.sample_spacing / radar.waveform.range_cell) @ transform
    transform /= np.real(amid @ np.exp(2j * np.pi / n * bins * (window.n_samples // 2)))
    total = np.zeros((raw.data.shape[0], len(points)), dtype=np.complex128)
    weight_sum = np.zeros(len(points))
    velocity = radar.track.velocity
    forward = velocity / np.linalg.norm(velocity, axis=1)[:, None]
    axis_sine = np.sum(forward * radar.pointing.boresight, axis=1)
    turn = np.gradient(axis_sine) if axis_sine.size > 1 else np.zeros(1)
    gap = np.linalg.norm(velocity, axis=1) * np.gradient(radar.track.time)
    for t in range(radar.track.n_pulses):
        line = points - radar.track.position[t]
        distance = np.linalg.norm(line, axis=1)
        direction = line / distance[:, None]
        place = (distance - window.start_range[t]) / window.sample_spacing
        series = np.exp(2j * np.pi / n * np.outer(bins, place))
        profile = raw.data[:, t].astype(np.complex128) @ transform @ series
        gain = _gain(radar, t, direction)
        weight = np.ones(len(points))
        if np.isfinite(radar.half_aperture):
            sine = direction @ forward[t]
            step = np.maximum(np.abs(gap[t] * (1.0 - sine**2) / distance + turn[t]), 1e-30)
            weight = np.clip((radar.half_aperture - np.abs(sine - axis_sine[t])) / step + 0.5, 0.0, 1.0)
        weight = weight * ((place >= 0.0) & (place <= window.n_samples - 1.0))
        cycles = np.mod(2.0 * radar.waveform.center_frequency / SPEED_OF_LIGHT * distance, 1.0)
        total += weight * gain * distance**2 * profile * np.exp(2j * np.pi * cycles)
        weight_sum += weight * gain**2
    lit = weight_sum > 1e-6 * radar.track.n_pulses
    return np.asarray(np.where(lit, total / np.where(lit, weight_sum, 1.0), 0.0) / radar.amplitude_constant)


def _gain(radar: Radar, pulse: int, direction: F64) -> F64:
    """Relative two-way amplitude of the beam towards unit vectors."""
    antenna, pointing = radar.antenna, radar.pointing
    if antenna.pattern == "isotropic":
        return np.ones(len(direction))
    scaled = [
        (direction @ axis[pulse]) / np.sin(0.5 * width)
        for axis, width in (
            (pointing.azimuth_axis, antenna.azimuth_beamwidth),
            (pointing.elevation_axis, antenna.elevation_beamwidth),
        )
    ]
    if antenna.pattern == "gaussian":
        gain = 0.5 ** (scaled[0] ** 2 + scaled[1] ** 2)
    else:  # sinc(0.4429)^2 = 1/2 of the power
        gain = np.prod([np.sinc(0.442946470689452 * s) ** 2 for s in scaled], axis=0)
    return np.asarray(np.where(direction @ pointing.boresight[pulse] > 0.0, gain, 0.0))


__all__ = ["CARRIERS", "DrawnEchoes", "direct_sum", "draw_echoes", "draw_wide"]
