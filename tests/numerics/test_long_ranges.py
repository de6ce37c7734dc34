"""Range against wavelength: 1 to 36 000 km at L, X and W band."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh

import sarmitsuba
from sarmitsuba.core.constants import SPEED_OF_LIGHT
from sarmitsuba.loading.build import SceneMesh, build_scene
from sarmitsuba.machine.backend import mi
from sarmitsuba.radar.description import RadarDescription
from sarmitsuba.radar.film import FilmDescription
from sarmitsuba.scene.settings import TraceSettings
from sarmitsuba.signal.image import SarImage
from sarmitsuba.signal.raw_data import RawData
from sarmitsuba.tracing.kernel.accumulators import phase_factor
from sarmitsuba.tracing.kernel.launch import frame_towards, lattice
from sarmitsuba.tracing.kernel.scene_tables import build_trace_scene
from sarmitsuba.truth.validation.targets import PEC, geometry, parallelogram
from tests.support.paths import coherent_flags, record_paths
from tests.support.unweighted import focus

BANDS = {"L": 1.27e9, "X": 9.65e9, "W": 94e9}
RANGES = (1e3, 10e3, 100e3, 800e3, 36_000e3)
SIZE = 50.0  # m: ground and wall


def slant_ranges(antenna: np.ndarray, start: np.ndarray) -> np.ndarray:
    """(2, n) slant ranges of single and double bounces of rays through ``start``, in NumPy; NaN where there is none.

    The scene is the ground z = 0, 0 < x < SIZE, and the wall x = 0, 0 < z < SIZE.
    """
    d = start - antenna
    d /= np.linalg.norm(d, axis=1)[:, None]

    def meet(o: np.ndarray, d: np.ndarray, axis: int) -> tuple[np.ndarray, np.ndarray]:
        t = -o[:, axis] / d[:, axis]
        p = o + d * t[:, None]
        free = p[:, 2 - axis]  # x on the ground, z on the wall
        return p, (t > 0) & (free > 0) & (free < SIZE) & (np.abs(p[:, 1]) < SIZE / 2)

    o = np.broadcast_to(antenna, d.shape)
    ground, on_ground = meet(o, d, 2)
    wall, on_wall = meet(o, d, 0)
    ground_first = on_ground & ~(on_wall & (wall[:, 2] > 0))
    p1 = np.where(ground_first[:, None], ground, wall)
    hit = on_ground | on_wall
    d2 = d * np.where(ground_first[:, None], [1, 1, -1], [-1, 1, 1])
    p2_wall, w = meet(p1, d2, 0)
    p2_ground, g = meet(p1, d2, 2)
    p2 = np.where(ground_first[:, None], p2_wall, p2_ground)
    again = hit & np.where(ground_first, w, g)
    one = np.linalg.norm(p1 - antenna, axis=1)
    two = 0.5 * (one + np.linalg.norm(p2 - p1, axis=1) + np.linalg.norm(p2 - antenna, axis=1))
    return np.stack([np.where(hit, one, np.nan), np.where(again, two, np.nan)])


def phase_error(slant_range: np.ndarray, truth: np.ndarray, frequency: float) -> float:
    """Rms error of the two-way phase that the accumulators form, degrees."""
    both = np.isfinite(slant_range) & np.isfinite(truth)
    assert both.sum() > 0.99 * np.isfinite(truth).sum()
    wavelength = SPEED_OF_LIGHT / frequency
    c = phase_factor(mi.Float64(slant_range[both]), wavelength)
    wrong = (c.real.numpy() + 1j * c.imag.numpy()) * np.exp(
        2j * np.pi * np.mod(2 * truth[both] / wavelength, 1)
    )
    return float(np.degrees(np.sqrt(np.mean(np.angle(wrong) ** 2))))


def test_phase_of_every_ray(row) -> None:
    """A wall on ground, 50 m, single and double bounces: the kernel's phases against NumPy's.

    Naive ways: lengths and phases in float32 (random phases from 10 km on); hit points o + t d of a float32 ray
    from the antenna (the same).
    """
    scene = geometry(
        [
            parallelogram([0, -SIZE / 2, 0], [SIZE, 0, 0], [0, SIZE, 0]),
            parallelogram([0, -SIZE / 2, 0], [0, SIZE, 0], [0, 0, SIZE]),
        ]
    )
    built = build_trace_scene(scene, PEC, 0.03)
    # without the tubes' phase integral contributions stand at the hits, whose lengths are known
    at_hits = coherent_flags(PEC, ("VV",), 2, tube_phase=False)
    single = replace(at_hits, double_phase=False)
    center = np.array([0.3 * SIZE, 0.0, 0.3 * SIZE])
    look = np.array([np.sin(np.radians(40.0)), 0.1, np.cos(np.radians(40.0))])
    look /= np.linalg.norm(look)
    grid = lattice(0.7 * SIZE, 0.7 * SIZE, SIZE / 60)
    worst = dict.fromkeys(BANDS, 0.0)
    naive_single = dict.fromkeys(BANDS, 0.0)
    naive_hit = 0.0
    for distance in RANGES:
        antenna = center + distance * look
        frame = frame_towards(antenna[None], center, np.array([0.0, 1.0, 0.0]))
        xy = np.stack([grid.x, grid.y], axis=1).astype(np.float64)
        start = frame.center[0] + xy @ np.stack([frame.axis_x[0], frame.axis_y[0]])
        truth = slant_ranges(antenna, start)
        common = {"position": antenna, "frame": frame, "grid": grid, "frequency": 9.65e9, "scene": built}
        double = record_paths(scene, PEC, **common, flags=at_hits).slant_range
        float32 = record_paths(scene, PEC, **common, flags=single).slant_range
        for band, frequency in BANDS.items():
            worst[band] = max(worst[band], phase_error(double, truth, frequency))
            if distance >= 100e3:
                naive_single[band] = max(naive_single[band], phase_error(float32, truth, frequency))
        if distance == 800e3:
            d = (start - antenna) / np.linalg.norm(start - antenna, axis=1)[:, None]
            ray = mi.Ray3f(mi.Point3f(*map(float, antenna)), mi.Vector3f(d.T.astype(np.float32)))
            t = built.mi_scene.ray_intersect_preliminary(ray).t.numpy().astype(np.float64)
            t[~np.isfinite(t)] = np.nan
            naive_hit = phase_error(t[None], truth[:1] + 0 * t, BANDS["X"])
    for band in BANDS:
        row(
            f"phase of every ray, 1 to 36 000 km, {band} band",
            worst[band],
            1.0,
            "deg rms",
            naive=naive_single[band],
            remedy="lengths, rays and phases in float64, reduced to one cycle before the sine",
        )
    row(
        "the same, X band: hit points o + t d of a float32 ray from 800 km away",
        worst["X"],
        1.0,
        "deg rms",
        naive=naive_hit,
        remedy="rays start next to the scene; hit points in float64 from the facet",
    )


def point_image(distance: float, band: str) -> tuple[SarImage, RawData]:
    scene = sarmitsuba.load_scene(
        "point",
        parameters={
            "slant_range": f"{distance}",
            "speed": "7600",
            "sar_antenna.center_frequency": f"{BANDS[band]}",
            "sar_antenna.mode": "spotlight",
            "sar_antenna.n_pulses": "128",
            # the antenna moves by 2 km until an echo is back from 36 000 km: another image, not another precision
            "sar_path.motion_in_pulse": "off",
        },
    )
    raw = sarmitsuba.simulate(scene)
    return focus(raw, request=scene.image), raw


@pytest.mark.filterwarnings("ignore:.*motion_in_pulse is switched off")
@pytest.mark.parametrize("band", BANDS)
def test_image_of_a_point_is_the_same_from_any_range(row, band: str) -> None:
    """Level, phase and every pixel's modulus of a point 1 to 36 000 km away.

    Naive way: ranges rounded to float32 before the phase is formed; the image dissolves.
    """
    reference, _ = point_image(10e3, band)
    wanted = np.abs(reference.total())
    peak = np.unravel_index(np.argmax(wanted), wanted.shape)
    change, naive = 0.0, np.inf
    for distance in RANGES:
        image, raw = point_image(distance, band)
        z = image.total()[
            :, : wanted.shape[1]
        ]  # at 1 km the slant grid of the same ground is a column longer
        change = max(change, float(np.abs(np.abs(z) - wanted).max()))
        assert abs(np.degrees(np.angle(z[peak]))) < 0.1  # tol: float32 of the image
        if distance == 800e3:
            exact = np.linalg.norm(raw.radar.track.position, axis=1)
            rounding = exact.astype(np.float32).astype(np.float64) - exact
            turned = raw.data * np.exp(-4j * np.pi / raw.radar.waveform.wavelength * rounding)[:, None]
            wrong = focus(
                RawData(turned.astype(np.complex64), raw.layers, raw.domain, raw.radar, raw.metadata),
                grid=image.grid,
            )
            naive = float(np.abs(np.abs(wrong.total()[:, : wanted.shape[1]]) - wanted).max())
    # tol: at 1 km the 0.1 rad aperture's range curvature over the 16 m image itself, 1.5e-3
    row(
        f"image of a point, 1 to 36 000 km, {band} band: largest change of a pixel over the peak",
        change,
        2e-3,
        naive=naive,
        remedy="float64 ranges",
    )


@pytest.mark.filterwarnings("ignore:.*edge_diffraction is switched off")
def test_fine_rays_from_afar_return_the_same() -> None:
    """A tilted plate from 10 to 36 000 km in X band, 1 W transmitted: amplitudes of single tubes below 1e-20."""
    body = trimesh.creation.box(extents=[0.25, 0.3, 0.001])
    body.apply_transform(trimesh.transformations.rotation_matrix(0.5, [0.3, 1.0, 0.0]))
    energy = []
    for distance in (10e3, 800e3, 36_000e3):
        radar = RadarDescription(center_frequency=BANDS["X"], slant_range=distance, n_pulses=2)
        film = FilmDescription(image_extent_azimuth=3.0, image_extent_range=3.0)
        settings = TraceSettings(
            method="raw", ray_spacing=6e-4, max_depth=1, effects={"edge_diffraction": "off"}
        )
        scene = build_scene([SceneMesh.of(body, "pec", "plate")], radar=radar, film=film, settings=settings)
        data = sarmitsuba.simulate(scene).data.astype(np.complex128)
        energy.append(float(np.sum(np.abs(data) ** 2)) * distance**4)
    # tol: the spherical wave over 0.4 m at 10 km, 2 mrad of phase; rays that miss the rim by rounding
    assert energy == pytest.approx([energy[0]] * 3, rel=0.01)
