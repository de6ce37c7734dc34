"""Method image in modes whose beam passes over the pixels in turn: the phase of the focused image, at every place."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from numpy.typing import NDArray

from sarmitsuba.core.arrays import C128, F64
from sarmitsuba.core.errors import DataError, RadarError
from sarmitsuba.loading.build import SceneMesh, build_scene
from sarmitsuba.radar.description import RadarDescription
from sarmitsuba.radar.film import FilmDescription
from sarmitsuba.radar.radar import Radar
from sarmitsuba.scene.geometry import PointTarget
from sarmitsuba.scene.motion import Motion
from sarmitsuba.scene.scene import Scene
from sarmitsuba.scene.settings import TraceSettings
from sarmitsuba.signal.focusing.windows import parse_window
from sarmitsuba.simulation.execution.image import Imager
from sarmitsuba.simulation.execution.run import Run
from tests.support.unweighted import render

# the pulses of drawn radars are denser than the program would choose, and sliding beams wider
pytestmark = pytest.mark.filterwarnings("ignore::sarmitsuba.core.errors.SarmitsubaWarning")

LIGHT = 299792458.0
WINDOWS = [("rectangular", "rectangular"), ("hamming", "taylor"), ("rectangular", "hamming")]
# cells of an image, along each axis
CELLS = 24.0
SOIL = {
    "material": "medium_dry_ground",
    "rms_height": 0.05,
    "diffuse_law": "constant",
    "diffuse_level_db": -10.0,
}


@dataclass(frozen=True)
class Draw:
    """A radar, a place for its image, and the windows."""

    radar: RadarDescription
    center: F64
    cell: float
    grid: str
    windows: tuple[str, str]

    def scene(self, points: tuple[PointTarget, ...] = (), meshes: tuple[SceneMesh, ...] = ()) -> Scene:
        extent = CELLS * self.cell
        film = FilmDescription(
            image_grid=self.grid,  # type: ignore[arg-type]
            image_center_x=float(self.center[0]),
            image_center_y=float(self.center[1]),
            image_height=0.0,
            image_extent_azimuth=extent,
            image_extent_range=extent,
        )
        settings = TraceSettings(method="image", max_depth=2)
        return build_scene(list(meshes), points, radar=self.radar, film=film, settings=settings)


def draw(rng: np.random.Generator, mode: str, squint: float, **changes: object) -> Draw:
    """Anywhere on the strip, in any direction; pulses dense enough that no ambiguity lies in the image."""
    cell, frequency, slant = rng.choice([0.3, 0.5, 1.0]), rng.choice([5.4e9, 9.6e9, 17e9]), 3e3
    spread = LIGHT / frequency / (2.0 * cell)  # of the lines of sight of an aperture
    heading, side = rng.uniform(0.0, 360.0), rng.choice(["left", "right"])
    sliding = float(rng.choice([0.2, 0.3, 0.6]))
    beam = rng.uniform(1.0, 2.0) * spread * (sliding if mode == "sliding_spotlight" else 1.0)
    radar = RadarDescription(
        mode=mode,
        pattern=str(rng.choice(["gaussian", "rectangular"])),
        slant_range=slant,
        aim_x=0.0,
        aim_y=0.0,
        aim_z=0.0,
        look_angle_deg=rng.uniform(max(35.0, abs(squint) + 15.0), 60.0),
        heading_deg=heading,
        look_side=str(side),  # type: ignore[arg-type]
        squint_angle_deg=squint,
        center_frequency=frequency,
        bandwidth=LIGHT / (2.0 * cell),
        azimuth_resolution=cell,
        azimuth_beamwidth_deg=float(np.degrees(beam)),
        elevation_beamwidth_deg=20.0,
        prf=2.5 * 100.0 / cell * (sliding if mode == "sliding_spotlight" else 1.0),
        mode_parameters={"sliding_factor": sliding} if mode == "sliding_spotlight" else {},
    )
    radar = replace(radar, **changes)  # type: ignore[arg-type]
    h = np.radians(heading)
    along = np.array([np.sin(h), np.cos(h), 0.0])
    across = np.array([np.cos(h), -np.sin(h), 0.0]) * (1.0 if side == "right" else -1.0)
    away = rng.uniform(-0.1, 0.1, 2) * slant * (mode != "spotlight")
    center = along * away[0] + across * away[1]
    grid, windows = str(rng.choice(["slant", "ground"])), WINDOWS[rng.integers(len(WINDOWS))]
    return Draw(radar, center, float(cell), grid, windows)


def cloud(rng: np.random.Generator, made: Draw, n: int) -> tuple[PointTarget, ...]:
    """Points all over the image, of drawn RCS and phase."""
    reach = 0.33 * CELLS * made.cell * np.array([1.0, 1.0, 0.0])  # within the image, however that is turned
    return tuple(
        PointTarget(
            f"p{i}",
            made.center + rng.uniform(-1.0, 1.0, 3) * reach,
            float(rng.exponential()) + 0.1,
            float(rng.uniform(-3.0, 3.0)),
        )
        for i in range(n)
    )


def exact(radar: Radar, points: tuple[PointTarget, ...], pixels: F64, windows: tuple[str, str]) -> C128:
    """Sum over band and pulses, pixel by pixel: what backprojection converges to, without any of its code."""
    track, pointing, wave = radar.track, radar.pointing, radar.waveform
    forward = track.velocity / np.linalg.norm(track.velocity, axis=1)[:, None]

    def seen(places: F64, of: slice) -> tuple[F64, ...]:
        """Distance, gain and sine off the boresight along the flight, (places, pulses)."""
        line = places[:, None] - track.position[of]
        distance = np.linalg.norm(line, axis=-1)
        axes = (pointing.azimuth_axis[of], pointing.elevation_axis[of], forward[of])
        x, y, z = (np.einsum("pti,ti->pt", line, axis) / distance for axis in axes)
        middle = np.einsum("ti,ti->t", pointing.boresight[of], forward[of])
        return distance, np.asarray(radar.antenna.two_way_amplitude(x, y)), z - middle

    far, own, sine = seen(pixels, slice(None))
    if np.isfinite(radar.half_aperture):
        part = sine / radar.half_aperture
        inside = np.clip((1.0 - np.abs(part)) / np.abs(np.gradient(part, axis=1)) + 0.5, 0.0, 1.0)
        weight = parse_window(windows[1])(np.clip(0.5 * part, -0.5, 0.5)) * inside * own
    else:
        n = track.n_pulses
        weight = parse_window(windows[1])((np.arange(n) + 0.5) / n - 0.5) * own
    lit = np.flatnonzero(weight.any(axis=0))
    lit = slice(lit[0], lit[-1] + 1)
    far, own, weight = far[:, lit], own[:, lit], weight[:, lit]
    place = np.array([p.position for p in points])
    root = np.array([np.sqrt(p.rcs) * np.exp(1j * p.phase) for p in points])
    way, gain, _ = seen(place, lit)

    # the range response from a table, 32 to a cell
    band = (np.arange(65) + 0.5) / 65 - 0.5
    share = parse_window(windows[0])(band)
    wavenumber = 4.0 * np.pi / LIGHT
    largest = 1.5 * np.linalg.norm(np.ptp(np.vstack([pixels, place]), axis=0))
    x = np.linspace(-largest, largest, int(64.0 * largest * wave.bandwidth / LIGHT) + 2)
    table = np.exp(1j * wavenumber * wave.bandwidth * np.multiply.outer(x, band)) @ share / share.sum()
    out = np.zeros(len(pixels), dtype=np.complex128)
    for i, ahead in enumerate(far[:, None] - way):
        h = np.interp(ahead, x, table.real) + 1j * np.interp(ahead, x, table.imag)
        h *= np.exp(1j * wavenumber * wave.center_frequency * ahead) * gain * (far[i] / way) ** 2
        out[i] = root @ (h @ weight[i]) / (weight[i] @ own[i])
    return out


def coherence(a: NDArray[np.complexfloating], b: NDArray[np.complexfloating]) -> complex:
    return complex(np.vdot(a, b) / np.sqrt(np.vdot(a, a).real * np.vdot(b, b).real))


def check_cloud(rng: np.random.Generator, made: Draw, where: object) -> None:
    scene = made.scene(cloud(rng, made, 80))
    image = Imager(Run(scene), range_window=made.windows[0], azimuth_window=made.windows[1]).image()
    pick = tuple(rng.integers(0, n, 30) for n in image.grid.shape)
    want = exact(scene.radar, scene.points, image.grid.positions()[pick], made.windows)
    found = image.total()[pick]
    # tol: 0.99 as promised; 0.9999 to 0.996 is usual, what is left are side lobes of far points
    assert abs(coherence(want, found)) > 0.99, where
    # tol: the same side lobes; degrees
    assert abs(np.degrees(np.angle(coherence(want, found)))) < 2.0, where


def check_point(rng: np.random.Generator, made: Draw, where: object) -> None:
    scene = made.scene(cloud(rng, made, 1))
    image = Imager(Run(scene), range_window=made.windows[0], azimuth_window=made.windows[1]).image()
    peak = np.unravel_index(np.abs(image.total()).argmax(), image.grid.shape)
    rows = np.clip(peak[0] + np.array([0, -1, 1, 0, 0]), 0, image.grid.shape[0] - 1)
    columns = np.clip(peak[1] + np.array([0, 0, 0, -1, 1]), 0, image.grid.shape[1] - 1)
    want = exact(scene.radar, scene.points, image.grid.positions()[rows, columns], made.windows)
    found = image.total()[rows, columns]
    ratio = found[0] / want[0]
    assert abs(20.0 * np.log10(abs(ratio))) < 0.05, where  # tol: as promised; gridding of 4 cells leaves 0.03
    assert abs(np.degrees(np.angle(ratio))) < 1.0, where  # tol: as promised
    for low, high in ((1, 2), (3, 4)):
        # apex of a parabola through three pixels of half a cell
        a, b = (
            0.5 * (abs(v[high]) - abs(v[low])) / (2.0 * abs(v[0]) - abs(v[low]) - abs(v[high]))
            for v in (want, found)
        )
        assert abs(a - b) < 0.1, where  # tol: 0.05 cells as promised


@pytest.mark.parametrize(
    ("mode", "squint"),
    [
        pytest.param("stripmap", 10.0, marks=pytest.mark.slow),
        ("stripmap", -30.0),
        ("sliding_spotlight", 15.0),
    ],
)
def test_points_anywhere_on_the_strip(mode: str, squint: float) -> None:
    # Rationale: the impulse response of the centre pixel's Doppler for all rows gave a coherence of 0.45 at a squint of
    # 10 deg, and 0.06 a kilometre off the aim point of sliding spotlight.
    rng = np.random.default_rng([int(squint) % 360, len(mode)])
    made = draw(rng, mode, squint)
    check_cloud(rng, made, made)
    check_point(rng, made, made)


def test_what_one_response_does_not_serve_is_refused() -> None:
    rng = np.random.default_rng(3)
    # a track of one aperture in stripmap: the rows at the ends lack half of theirs
    short = draw(rng, "stripmap", 0.0, azimuth_resolution=0.0, n_pulses=300, prf=300.0, pattern="gaussian")
    short = replace(short, center=np.array([0.0, 0.0, 0.0]), cell=2.0)
    # a beam that all but stays where it is
    slow = draw(rng, "sliding_spotlight", 0.0, mode_parameters={"sliding_factor": 0.02})
    slow = replace(slow, center=np.array([0.0, 0.0, 0.0]))
    for made in (short, slow):
        with pytest.raises(DataError, match="take method hybrid"):
            Imager(Run(made.scene(cloud(rng, made, 3)))).image()


def test_what_moves_under_a_beam_that_passes_is_refused() -> None:
    made = draw(np.random.default_rng(4), "stripmap", 5.0)
    mover = PointTarget("car", made.center, 1.0, 0.0, Motion(velocity=(1.0, 0.0, 0.0)))
    with pytest.raises(RadarError, match="take method hybrid, or set moving_targets off"):
        render(made.scene((mover,)))


def test_raster_looks_from_where_the_beam_passes() -> None:
    # Rationale: broadside stripmap sees a roof far off the aim point from abreast, so its shadow lies straight behind;
    # from mid-track, 0.3 rad off, it would be 2 m aside.
    radar = RadarDescription(
        mode="stripmap",
        pattern="gaussian",
        slant_range=5e3,
        look_angle_deg=50.0,
        bandwidth=150e6,
        azimuth_resolution=1.0,
        azimuth_beamwidth_deg=1.2,
        elevation_beamwidth_deg=20.0,
        aim_x=0.0,
        aim_y=0.0,
        aim_z=0.0,
    )
    made = Draw(radar, np.array([0.0, 1500.0, 0.0]), 2.0, "ground", WINDOWS[0])
    corners = np.array([[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [1.0, 1.0, 0.0], [-1.0, 1.0, 0.0]])
    two = np.array([[0, 1, 2], [0, 2, 3]])
    roof = corners * 2.0 + made.center + np.array([0.0, 0.0, 10.0])
    meshes = (
        SceneMesh(corners * 40.0 + made.center, two, SOIL, "ground"),
        SceneMesh(roof, two, SOIL, "roof"),
    )
    scene = made.scene(meshes=meshes).replace(speckle="off")
    power = np.abs(Imager(Run(scene)).raster().total()) ** 2
    behind = power[:, power.shape[1] // 2 :]
    dark = (behind < 0.3 * np.median(power)).sum(axis=1)
    azimuth = (np.arange(power.shape[0]) - power.shape[0] // 2) * (CELLS * 2.0 / power.shape[0])
    assert dark.sum() > 5
    assert abs(float(dark @ azimuth) / dark.sum()) < 0.5  # tol: a pixel


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(24))
def test_points_in_drawn_modes(seed: int) -> None:
    rng = np.random.default_rng([7, seed])
    mode = ("stripmap", "sliding_spotlight", "spotlight")[min(seed % 5 // 2, 2)]
    made = draw(rng, mode, float(rng.uniform(-30.0, 30.0)))
    check_cloud(rng, made, (seed, made))
    check_point(rng, made, (seed, made))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("mode", "squint", "polarisation"),
    [
        ("stripmap", 10.0, "VV"),
        ("stripmap", 30.0, "HH"),
        ("sliding_spotlight", 0.0, "HH"),
        ("sliding_spotlight", -20.0, "VV"),
        ("spotlight", 15.0, "VV"),
    ],
)
def test_traced_clutter_and_plates_have_the_phase_of_hybrid(
    mode: str, squint: float, polarisation: str
) -> None:
    # Rationale: the images can be subtracted. Rough ground has the same scatterers in both, and small plates turned to
    # the beam a lobe wider than the aperture.
    rng = np.random.default_rng([int(squint) % 360, len(mode), ord(polarisation[0])])
    made = replace(draw(rng, mode, squint, polarisation=polarisation), windows=WINDOWS[0])
    reach, spare = 0.7 * CELLS * made.cell, made.scene(cloud(rng, made, 1)).radar
    corners = np.array([[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [1.0, 1.0, 0.0], [-1.0, 1.0, 0.0]])
    two = np.array([[0, 1, 2], [0, 2, 3]])
    meshes = [SceneMesh(corners * reach + made.center, two, SOIL, "ground")]
    back = -spare.pointing.boresight[spare.track.center_index]
    for i in range(4):
        normal = back + rng.normal(0.0, 0.01, 3)
        across = np.cross(normal, [0.0, 0.0, 1.0])
        half = 4.0 * LIGHT / spare.waveform.center_frequency
        axes = np.array([across, np.cross(normal, across)]) * half
        middle = made.center + np.array([*rng.uniform(-0.4, 0.4, 2) * CELLS * made.cell, 1.0])
        meshes.append(SceneMesh(middle + corners[:, :2] @ axes, two, "pec", f"plate {i}"))
    scene = made.scene(meshes=tuple(meshes))
    want, found = (render(scene, method=method).total() for method in ("hybrid", "image"))
    # tol: 0.99 as promised; 0.9995 is usual
    assert abs(coherence(want, found)) > 0.99
    # tol: far side lobes and azimuth ambiguities, which image leaves out
    assert abs(10.0 * np.log10(np.vdot(found, found).real / np.vdot(want, want).real)) < 0.1
    assert abs(np.degrees(np.angle(coherence(want, found)))) < 1.0  # tol: as promised
