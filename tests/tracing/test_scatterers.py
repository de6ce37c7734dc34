"""What rough surfaces return does not depend on how they are cut, how they lie, or how they are looked at."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import minimize

from sarmitsuba.core.arrays import C64, F64
from sarmitsuba.loading.library import resolve, resolve_radar
from sarmitsuba.loading.load import load_scene
from sarmitsuba.machine.backend import dr, mi
from sarmitsuba.scene.geometry import Geometry
from sarmitsuba.scene.materials.material import Material
from sarmitsuba.scene.scene import Scene
from sarmitsuba.signal.focusing import default_grid
from sarmitsuba.simulation.execution.render import simulate
from sarmitsuba.simulation.execution.run import Run
from sarmitsuba.simulation.execution.tracing import AntennaStates
from sarmitsuba.simulation.planning.sampling.density_plan import CELLS_PER_RESOLUTION
from sarmitsuba.tracing.kernel.source import Launch, launches
from sarmitsuba.tracing.kernel.state import Contribution
from sarmitsuba.tracing.kernel.surfaces import Surfaces
from tests.support.draws import few_of
from tests.support.unweighted import focus

LEVEL_DB = -10.0
SIGMA0 = 10.0 ** (LEVEL_DB / 10.0)
# resolution of the radar of these scenes, m: what "cell" is here
RESOLUTION = 0.5
X, Y, Z = np.eye(3)


# so rough that nothing returns coherently; the same sigma0 at every angle
ROUGH = Material(
    "rough", permittivity=5.0 - 0.5j, rms_height=0.05, diffuse_law="constant", diffuse_level_db=LEVEL_DB
)


def quad(corner: F64, a: F64, b: F64) -> F64:
    """Two triangles (2, 3, 3) of a parallelogram; its normal is along ``a x b``."""
    p, q, r, s = corner, corner + a, corner + a + b, corner + b
    return np.array([[p, q, r], [p, r, s]])


def box(low: F64, size: F64, turn: float = 0.0) -> F64:
    """Triangles (12, 3, 3) of a closed box turned about its own vertical axis, normals outwards."""
    x, y, z = np.diag(np.asarray(size, dtype=float))
    o = np.asarray(low, dtype=float)
    faces = [(o, y, x), (o + z, x, y), (o, x, z), (o + y, z, x), (o, z, y), (o + x, y, z)]
    out = np.concatenate([quad(*face) for face in faces])
    c, s = np.cos(turn), np.sin(turn)
    middle = o + 0.5 * (x + y)
    return (out - middle) @ np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]]) + middle


def scene_of(parts: list[F64], material: Material, extent: float, **radar: str) -> Scene:
    """One mesh per part under a spotlight radar at 10 km of 0.5 m resolution, seen under 35 degrees."""
    base = load_scene(
        resolve("flat_ground"), parameters={f"sar_antenna.{key}": value for key, value in radar.items()}
    )
    triangles = np.concatenate(parts)
    sizes = [len(p) for p in parts]
    geometry = Geometry(
        triangles.reshape(-1, 3),
        np.arange(3 * len(triangles), dtype=np.int32).reshape(-1, 3),
        np.zeros(len(triangles), dtype=np.int32),
        np.repeat(np.arange(len(parts)), sizes).astype(np.int32),
        tuple(f"part {i}" for i in range(len(parts))),
        np.concatenate([[0], np.cumsum(sizes)]).astype(np.int64),
    )
    image = replace(base.image, extent_azimuth=extent, extent_range=extent)
    return replace(base, geometry=geometry, materials=(material,), image=image)


class _Power:
    """Sum of |amplitude|^2 of the first channel: the mean echo energy of independent scatterers."""

    def __init__(self) -> None:
        self.memory = dr.zeros(mi.Float64, 1)

    def before(self, launch: Launch, n_pulses: int) -> None:
        pass

    @property
    def written(self) -> list[mi.Float64]:
        return [self.memory]

    def begin(self) -> tuple[Any, ...]:
        return (mi.UInt32(0), mi.Float(0.0), mi.Float(0.0))

    def add(self, state: tuple[Any, ...], contribution: Contribution) -> tuple[Any, ...]:
        power = mi.Float64(dr.squared_norm(contribution.amplitudes[0]))
        dr.scatter_add(self.memory, power, mi.UInt32(0), contribution.active)
        return state


def returned_rcs(scene: Scene, seed: int = 0) -> float:
    """Mean RCS (m^2) of a rough scene at the middle of the aperture, from the lattices of rays that a run takes.

    Scatterers without speckle of their own: what is left of chance is how many of them a surface holds.
    """
    settings = replace(scene.settings, effects={"spreading": "on"}, max_depth=1, seed=seed)
    run = Run(replace(scene, settings=settings))
    assert run.sampling is not None
    track, middle = run.scene.radar.track, run.scene.radar.track.center_index
    pick = slice(middle, middle + 1)
    power = _Power()
    tracer = run.tracer(run.sampling, antenna_pattern=False)
    tracer.flags = replace(tracer.flags, speckle=False)
    for launch in launches([Surfaces()], run.lattices(run.sampling, 0)[0], 1):
        tracer.launch(launch, AntennaStates.on_tracks(run.scene.radar, pick), power)  # type: ignore[arg-type]
    distance = float(np.linalg.norm(track.position[middle]))
    return float(power.memory[0]) * (distance**2 / tracer.kernel.amplitude) ** 2


def areas(triangles: F64) -> F64:
    """(n,) m^2."""
    return 0.5 * np.linalg.norm(
        np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]), axis=1
    )


def facing(triangles: F64, antenna: F64) -> NDArray[np.bool_]:
    """Which triangles turn their outer side towards the antenna."""
    normal = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    return np.einsum("ti,ti->t", normal, antenna - triangles.mean(axis=1)) > 0.0


def level_error_db(parts: list[F64], expected_area: float, extent: float, seeds: int = 1) -> float:
    """Returned over expected power, dB, mean over seeds (other rays)."""
    scene = scene_of(parts, ROUGH, extent)
    found = np.mean([returned_rcs(scene, seed) for seed in range(seeds)])
    return float(10.0 * np.log10(found / (SIGMA0 * expected_area)))


@pytest.mark.parametrize("width", [pytest.param(0.33, marks=pytest.mark.slow), 0.62, 1.24, 2.5])
def test_level_ground_of_slabs(width: float) -> None:
    """Slabs that share no vertex, their rows shifted: every seam is a T-junction. Before: -3.1 to -0.7 dB."""
    w, half, gap = width * RESOLUTION, 8.0, 0.003
    parts = []
    rows = np.arange(-half, half - w, w)
    for i, y in enumerate(rows):
        parts += [
            quad(np.array([x, y, 0.0]), (w - gap) * X, (w - gap) * Y)
            for x in np.arange(-half, half - w, w) + 0.37 * w * (i % 2)
        ]
    error = level_error_db(parts, float(sum(areas(p).sum() for p in parts)), 30.0)
    # tol: 0.1 dB: nodes of a slab of 36, of which chance takes a few per cent, over hundreds of slabs
    assert abs(error) < 0.1


def test_steps() -> None:
    """A staircase of 0.30 m by 0.15 m, rising away from the radar, all of it seen. Before: -3.1 dB."""
    antenna = scene_of([box(np.zeros(3), np.ones(3))], ROUGH, 10.0).radar.track.center_position
    away = -np.sign(antenna[0])  # the radar looks along x
    parts = []
    for i in range(24):
        at = np.array([away * 0.30 * i, -6.0, 0.15 * i])
        parts += [quad(at, 12.0 * Y, 0.15 * Z), quad(at + 0.15 * Z, away * 0.30 * X, 12.0 * Y)]
    error = level_error_db(parts, 24 * 12.0 * 0.45, 30.0)
    # tol: 0.1 dB: 48 faces of 40 nodes and more
    assert abs(error) < 0.1


@pytest.mark.parametrize("size", [pytest.param(3.0, marks=pytest.mark.slow), 1.0, 0.5, 0.25, 0.1])
def test_patches(size: float) -> None:
    """Square patches, turned at random, at 0.5 m resolution. Before: -1.1 to -20 dB."""
    rng = np.random.default_rng(5)
    parts = []
    for i in range(25):
        turn = rng.random() * np.pi
        a = size * np.array([np.cos(turn), np.sin(turn), 0.0])
        at = np.array([6.0 * (i % 5), 6.0 * (i // 5), 0.0]) - 12.0 + rng.random(3) * [1.0, 1.0, 0.3]
        parts.append(quad(at, a, np.cross(Z, a)))
    error = level_error_db(parts, 25 * size**2, 50.0, seeds=2)
    # tol: 0.15 dB, three standard errors: 25 patches of 36 nodes or more, of which each holds 2 or 3 more or less
    assert abs(error) < 0.15


@pytest.mark.parametrize("width", [0.05, 0.1, 0.2, 0.4])
def test_strips(width: float) -> None:
    """Strips of 10 m at eight azimuths. Before: -4.1 to -2.1 dB."""
    parts = []
    for i, turn in enumerate(np.pi * (np.arange(8) + 0.3) / 8.0):
        along = np.array([np.cos(turn), np.sin(turn), 0.0])
        at = np.array([14.0 * (i % 3), 14.0 * (i // 3), 0.0]) - 14.0
        parts.append(quad(at - 5.0 * along, 10.0 * along, width * np.cross(Z, along)))
    error = level_error_db(parts, 8 * 10.0 * width, 60.0)
    # tol: 0.15 dB: 8 strips of 36 nodes or more
    assert abs(error) < 0.15


def test_lamp_posts() -> None:
    """Posts of 0.12 m by 6 m, turned at random: sigma0 times the sides that face the antenna. Before: -6.7 dB."""
    rng = np.random.default_rng(3)
    parts = [
        box(np.array([8.0 * (i % 4) - 12.0, 8.0 * (i // 4) - 12.0, 0.0]), np.array([0.12, 0.12, 6.0]), turn)
        for i, turn in enumerate(rng.random(16) * np.pi)
    ]
    antenna = scene_of(parts, ROUGH, 40.0).radar.track.center_position
    lit = sum(float(areas(p)[facing(p, antenna)].sum()) for p in parts)
    error = level_error_db(parts, lit, 45.0, seeds=2)
    # tol: 0.15 dB: 32 lit sides of 36 nodes or more
    assert abs(error) < 0.15


@pytest.mark.slow
def test_slabs_through_the_whole_chain() -> None:
    """Raw data, focused: the mean of slabs of 0.62 cells is sigma0. Before: -12.8 dB."""
    w, gap, half = 0.62 * RESOLUTION, 0.003, 8.0
    at = np.arange(-half, half - w, w)
    parts = [
        quad(np.array([x + 0.37 * w * (i % 2), y, 0.0]), (w - gap) * X, (w - gap) * Y)
        for i, y in enumerate(at)
        for x in at
    ]
    scene = scene_of(parts, ROUGH, 30.0)
    seeds = 3
    energy = []
    for seed in range(seeds):
        image = focus(simulate(scene, seed=seed))
        pixel = image.grid.azimuth_spacing * image.grid.range_spacing
        energy.append(
            float(np.sum(image.rcs())) * pixel / image.azimuth_resolution_cell / image.range_resolution_cell
        )
    area = float(sum(areas(p).sum() for p in parts))
    # resolution cells on level ground seen under 35 degrees
    looks = seeds * area * np.sin(np.radians(35.0)) / RESOLUTION**2
    error = 10.0 * np.log10(np.mean(energy) / (SIGMA0 * area))
    # tol: four standard errors of speckle
    assert abs(error) < 4.0 * 4.343 / np.sqrt(looks)


# ---- walls


def test_wall_has_no_storeys() -> None:
    """A wall under airborne_x: contrast of fully developed speckle, and no period in the mean over height.

    Before: contrast 1.12 to 1.64, cells of 1.36 range cells on the wall.
    """
    wall = quad(np.array([0.0, -20.0, 0.0]), 40.0 * Y, 12.0 * Z)
    plain = scene_of([wall], ROUGH, 60.0)
    radar = load_scene(resolve("flat_ground"), radar=resolve_radar("airborne_x"))
    scene = replace(radar, geometry=plain.geometry, materials=plain.materials, image=plain.image)
    rows, contrasts = [], []
    for seed in range(4):
        image = focus(simulate(scene, seed=seed))
        grid = image.grid
        antenna = scene.radar.track.center_position
        foot, top = (np.linalg.norm(antenna - np.array([0.0, 0.0, z])) for z in (0.0, 12.0))
        # a cell and a half from the ends
        step = 1.5 * image.range_resolution_cell
        inside = (grid.range > top + step) & (grid.range < foot - step)
        power = np.square(np.abs(image.total()))[np.abs(grid.azimuth) < 16.0][:, inside]
        contrasts.append(float(power.std() / power.mean()))
        rows.append(power.mean(axis=0))
    samples = 32.0 / image.azimuth_resolution_cell * np.ptp(grid.range[inside]) / image.range_resolution_cell
    # tol: three standard errors, one over the root of the independent samples of all surfaces
    assert abs(np.mean(contrasts) - 1.0) < 3.0 / np.sqrt(samples * len(contrasts))
    profile = np.mean(rows, axis=0)
    looks = len(rows) * 32.0 / image.azimuth_resolution_cell
    # tol: a spread of speckle alone, with three standard errors of a standard deviation of so many range cells
    cells = np.ptp(grid.range[inside]) / image.range_resolution_cell
    assert profile.std() / profile.mean() < (1.0 + 3.0 / np.sqrt(2.0 * cells)) / np.sqrt(looks)


# ---- the lattice


def nodes(cell: float, half: int) -> F64:
    """Scatterers of level ground, re-implemented: middles of square cells turned by the golden mean's angle."""
    i, j = (n.astype(float).ravel() + 0.5 for n in np.mgrid[-half : half + 1, -half : half + 1])
    angle = np.arctan(0.5 * (5.0**0.5 - 1.0))
    c, s = np.cos(angle), np.sin(angle)
    return cell * np.stack([c * i - s * j, s * i + c * j], axis=1)


@pytest.mark.parametrize("heading_deg", [0.0, 30.0, 45.0])
def test_no_lattice_shows_in_mean_clutter(heading_deg: float) -> None:
    """Mean clutter is the sum of |impulse response|^2 over the nodes, here of the coarsest cell. Before: to 1.9 dB."""
    cell = RESOLUTION / CELLS_PER_RESOLUTION
    place = nodes(cell, 60)
    # levels of the lattice in the middle, away from its ends
    rng = np.random.default_rng(1)
    heading = np.radians(heading_deg)
    turn = np.array([[np.cos(heading), np.sin(heading)], [-np.sin(heading), np.cos(heading)]])
    at = rng.uniform(-4.0, 4.0, (600, 2))
    found = np.empty(len(at))
    for k, point in enumerate(at):
        d = (place - point) @ turn.T
        # ground range resolution under 35 degrees of incidence; Hann-weighted bands, whose sidelobes decay
        found[k] = np.sum(
            np.square(_response(d[:, 0] / RESOLUTION) * _response(d[:, 1] * 0.5736 / RESOLUTION))
        )
    level_db = 10.0 * np.log10(found / found.mean())
    print(heading_deg, level_db.min(), level_db.max())
    assert np.ptp(level_db) < 0.2


def _response(x: F64) -> F64:
    """Impulse response of a flat band, in resolution cells."""
    return np.asarray(np.sinc(x))


# ---- two passes


def two_passes(seed: int, share: float, cells: tuple[float, float] = (0.0, 0.0)) -> tuple[float, float]:
    """Coherence of two passes over tilted ground once its fringes are removed, and how many independent cells it is of.

    Heading, look, slope and resolutions are drawn. The baseline is ``share`` of the critical one, at which the plane's
    spectra of both passes part: lambda R tan(i) / (2 resolution), i the incidence within the plane of range.
    """
    rng = np.random.default_rng([seed, 77])
    heading, look, slope, downhill = rng.uniform((0, 25, 0, 0), (360, 55, 8, 360))
    resolution, azimuth = np.exp(rng.uniform(np.log((0.3, 0.6)), np.log((2.0, 1.6))))
    azimuth *= resolution
    slant_range, wavelength, size = 10e3, 299_792_458.0 / 9.65e9, 40.0 * max(resolution, azimuth)
    tilt = np.tan(np.radians(slope)) * np.array(
        [np.cos(np.radians(downhill)), np.sin(np.radians(downhill)), 0.0]
    )
    ground = quad(-0.95 * size * (X + Y), 1.9 * size * X, 1.9 * size * Y)
    ground[..., 2] = ground @ tilt
    images, angle = [], 0.0
    for number in range(2):
        scene = scene_of(
            [ground],
            ROUGH,
            size,
            look_angle_deg=repr(float(look + np.degrees(angle))),
            heading_deg=repr(float(heading)),
            bandwidth=repr(float(299_792_458.0 / 2.0 / resolution)),
            azimuth_resolution=repr(float(azimuth)),
            slant_range=repr(slant_range),
        )
        scene = replace(scene, settings=replace(scene.settings, scatterer_cell=cells[number]))
        if number == 0:
            track = scene.radar.track
            along = track.position[-1] - track.position[0]
            along /= np.linalg.norm(along)
            line, normal = (w - (w @ along) * along for w in (track.center_position, Z - tilt))
            cosine = line @ normal / np.linalg.norm(line) / np.linalg.norm(normal)
            angle = share * wavelength * np.tan(np.arccos(cosine)) / (2.0 * scene.radar.waveform.range_cell)
        grid = default_grid(scene.radar, scene.image) if not images else images[0].grid
        images.append(focus(simulate(scene), grid))
    edge = tuple(slice(n // 10, -(n // 10)) for n in images[0].grid.shape)
    one, two = (image.total()[edge] for image in images)
    product = one * two.conj()
    extent = product.size * images[0].grid.azimuth_spacing * images[0].grid.range_spacing
    count = extent / (images[0].azimuth_resolution_cell * images[0].range_resolution_cell)
    energy = float(np.sqrt(np.square(np.abs(one)).sum() * np.square(np.abs(two)).sum()))
    return _fringe_sum(product) / energy, float(count)


def _fringe_sum(product: C64) -> float:
    """Largest magnitude of the sum over an image with a plane of phase removed."""
    rows, columns = np.indices(product.shape)

    def lost(slope: F64) -> float:
        fringe = np.exp(-2j * np.pi * (slope[0] * rows + slope[1] * columns))
        return -float(np.abs((product * fringe).sum()))

    spectrum = np.abs(np.fft.fft2(product, s=[4 * n for n in product.shape]))
    peak = np.array(np.unravel_index(spectrum.argmax(), spectrum.shape)) / spectrum.shape
    around = peak + 2e-3 * np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
    return -float(minimize(lost, peak, method="Nelder-Mead", options={"initial_simplex": around}).fun)


@pytest.mark.parametrize("share", [0.1, 0.3])
@pytest.mark.parametrize("seed", few_of(range(4)))
def test_two_passes_keep_their_coherence(seed: int, share: float) -> None:
    """Coherence 1 - B/Bc with automatic settings, at drawn headings. Before: 0.01 instead of 0.9."""
    coherence, cells = two_passes(seed, share)
    expected = 1.0 - share
    print(seed, share, coherence, cells)
    # tol: three standard errors (1 - g^2) / sqrt(2 n) of n independent cells; 0.015 for the theory's flat spectrum and
    # small angles
    assert abs(coherence - expected) < 3.0 * (1.0 - expected**2) / np.sqrt(2.0 * cells) + 0.015


def test_other_cells_are_other_scatterers() -> None:
    """So that the test above can tell: passes that do not share their cells have nothing in common."""
    coherence, cells = two_passes(0, 0.1, cells=(0.5, 0.35))
    # tol: the largest of the spectrum of so many independent products, sqrt(ln(n) / n) and a third
    assert coherence < 1.33 * np.sqrt(np.log(cells) / cells)


def test_no_ramp_is_left_between_two_passes() -> None:
    """Level ground at a tenth of the critical baseline, the flat earth removed. Before: a ramp of 0.1 rad/m."""
    ground = [quad(np.array([-16.0, -16.0, 0.0]), 32.0 * X, 32.0 * Y)]
    wavelength, slant_range, incidence = 299_792_458.0 / 9.65e9, 10e3, np.radians(35.0)
    critical = wavelength * slant_range * np.tan(incidence) / (2.0 * RESOLUTION)
    angle = 0.1 * critical / slant_range
    images = []
    for look in (35.0, 35.0 + np.degrees(angle)):
        scene = scene_of(ground, ROUGH, 20.0, look_angle_deg=str(look))
        grid = default_grid(scene.radar, scene.image) if not images else images[0].grid
        images.append(focus(simulate(scene), grid))
    product = images[0].total() * images[1].total().conj()
    x, _, _ = np.moveaxis(images[0].grid.positions(), -1, 0)
    phase = [np.angle(product[(x >= low) & (x < low + 4.0)].sum()) for low in (-8.0, -4.0, 0.0, 4.0)]
    slope = np.polyfit([-6.0, -2.0, 2.0, 6.0], np.unwrap(phase), 1)[0]
    # tol: each strip's phase is known to sqrt((1 - g^2) / (2 g^2 n)) = 0.02 rad, n = 250 cells
    assert abs(slope) < 3.0 * 0.02 / np.sqrt(6.0**2 + 2.0**2 + 2.0**2 + 6.0**2)
