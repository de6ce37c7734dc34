"""Images smaller than their scenes: what is beside them leaves nothing in them, whatever it is and whoever looks."""

import warnings
from dataclasses import replace

import numpy as np
import pytest

from sarmitsuba import FilmDescription, RadarDescription, Scene, SceneMesh, SceneVolume, build_scene
from sarmitsuba.core.arrays import C64, F64
from sarmitsuba.core.errors import RadarError, SarmitsubaWarning
from sarmitsuba.radar.antenna import Pointing
from sarmitsuba.radar.radar import Radar
from sarmitsuba.radar.track import Track
from sarmitsuba.scene.geometry import PointTarget
from sarmitsuba.scene.materials.vegetation.canopy import water_cloud
from sarmitsuba.scene.mesh import tessellate
from sarmitsuba.scene.motion import Motion
from sarmitsuba.scene.settings import TraceSettings
from sarmitsuba.signal.focusing.ideal import ideal_echoes
from sarmitsuba.signal.image import SarImage
from sarmitsuba.simulation.execution.render import simulate
from sarmitsuba.simulation.planning.sampling.folding import check_folding
from sarmitsuba.simulation.planning.sampling.launch_window import launch_windows
from sarmitsuba.tracing.scatterers.wires.kind import WireTarget
from tests.support.draws import few_of
from tests.support.unweighted import focus, render

CLOUD = water_cloud("cloud", (0.1, 0.05), (0.2, 0.4), 0.2)
MODES = ("spotlight", "stripmap", "sliding_spotlight")
SEEDS = few_of(range(24))


def drawn(seed: int) -> tuple[RadarDescription, F64, F64, np.random.Generator]:
    """A radar of drawn mode, heading, side, squint and resolution; unit vectors along and across its track."""
    rng = np.random.default_rng([seed, 24])
    mode = MODES[seed % 3]
    heading = float(rng.uniform(0.0, 360.0))
    side = ("left", "right")[rng.integers(2)]
    radar = RadarDescription(
        mode=mode,
        heading_deg=heading,
        look_side=side,
        slant_range=float(rng.uniform(4e3, 7e3)),
        look_angle_deg=float(rng.uniform(30.0, 50.0)),
        squint_angle_deg=float(rng.uniform(-6.0, 6.0)) if rng.integers(2) else 0.0,
        azimuth_resolution=float(rng.uniform(1.2, 2.0)),
        bandwidth=float(rng.uniform(80e6, 130e6)),
        center_frequency=5e9,
        speed=100.0,
        aim_x=0.0,
        aim_y=0.0,
        aim_z=0.0,
    )
    if mode != "spotlight":
        radar = replace(radar, pattern="gaussian", antenna_length=1.8, antenna_height=0.1)
    h = np.radians(heading)
    along = np.array([np.sin(h), np.cos(h), 0.0])
    across = np.array([along[1], -along[0], 0.0]) * (1.0 if side == "right" else -1.0)
    return radar, along, across, rng


def film(extent: float) -> FilmDescription:
    """A square image on the ground."""
    return FilmDescription(
        image_extent_azimuth=extent,
        image_extent_range=extent,
        pixel_spacing_azimuth=0.6,
        pixel_spacing_range=0.6,
        image_grid="ground",
        image_center_x=0.0,
        image_center_y=0.0,
    )


def middle(image: SarImage, half: float) -> C64:
    """Pixels up to ``half`` (m) from the image's middle."""
    grid = image.grid
    rows, columns = (np.abs(axis - 0.5 * (axis[0] + axis[-1])) < half for axis in (grid.azimuth, grid.range))
    return image.total()[rows][:, columns]


def error_db(found: C64, wanted: C64) -> float:
    """Power of the difference over that of what is wanted, dB."""
    return float(10.0 * np.log10((np.abs(found - wanted) ** 2).sum() / (np.abs(wanted) ** 2).sum()))


def denser(radar: Radar) -> Radar:
    """The same aperture with four times the pulses."""
    track, p, window = radar.track, radar.pointing, radar.window
    finer = Track.straight(
        track.position.mean(axis=0), track.velocity[0], 4.0 * track.prf, 4 * track.n_pulses
    )
    axes = (np.repeat(axis, 4, axis=0) for axis in (p.boresight, p.azimuth_axis, p.elevation_axis))
    return replace(
        radar,
        track=finer,
        pointing=Pointing(*axes),
        window=replace(window, start_range=np.repeat(window.start_range, 4)),
    )


@pytest.mark.parametrize("seed", SEEDS)
def test_points_beside_leave_nothing_at_the_automatic_prf(seed: int) -> None:
    """Against the exact sum over the points in the image and on its fade-out, at a prf of four times the program's."""
    radar, along, across, rng = drawn(seed)
    extent = float(rng.uniform(24.0, 90.0))  # 12 cells too, whose fade-out is nearly as long as the image
    cell = max(radar.azimuth_resolution, 299792458.0 / (2.0 * radar.bandwidth))
    fade = max(0.025 * extent, 10.0 * cell)
    inside = rng.uniform(-0.35, 0.35, (3, 2)) * extent
    edge = np.array([[0.5 * extent + rng.uniform(0.2, 0.9) * fade, 0.0]]) * rng.choice([-1.0, 1.0])
    far = np.column_stack(
        [rng.uniform(0.5, 3.0, 4) * extent + fade, rng.uniform(-0.4, 0.4, 4) * extent]
    ) * rng.choice([-1.0, 1.0], (4, 1))
    beyond = float(np.abs(edge[0, 0]) - 0.5 * extent)
    places = [p[0] * along + p[1] * across for p in (*inside, *edge, *far)]
    rcs = [1.0] * 3 + [2.0] + [1e5] * 4
    points = [PointTarget(f"p{i}", p, s) for i, (p, s) in enumerate(zip(places, rcs, strict=True))]
    scene = build_scene(points=points, radar=radar, film=film(extent))
    raw = simulate(scene)
    notes = [note for note in raw.metadata["notes"] if "left out" in note]
    assert len(notes) == 1 and '"p4"' in notes[0] and "and 3 more" in notes[0]
    share = 0.5 + 0.5 * np.cos(np.pi * beyond / fade)
    lit = np.array([*rcs[:3], rcs[3] * share**2])
    exact = focus(
        ideal_echoes(denser(scene.radar), np.array(places[:4]), lit),
        request=scene.image,
        focuser="backprojection",
    )
    image = focus(raw, request=scene.image, focuser="backprojection")
    # tol: the sum over pulses for the integral, at the apertures' ends
    assert error_db(middle(image, 0.4 * extent), middle(exact, 0.4 * extent)) < -28.0


def layered(radar: RadarDescription, extent: float, half: float, **changes: object) -> Scene:
    """A layer that scatters and a grid of wires, ``half`` (m) to every side, over a mirror."""
    vertices, faces = tessellate.cube()
    box = np.array([-half, -half, 0.0]) + 0.5 * (vertices + 1.0) * np.array([2 * half, 2 * half, 2.0])
    ground = 1.5 * half * np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
    wires = [
        WireTarget(f"w{i}", np.array([-half, y, 3.0]), np.array([half, y, 3.0]), 0.005)
        for i, y in enumerate(np.linspace(-half, half, 5))
    ]
    return build_scene(
        [SceneMesh(ground, np.array([[0, 1, 2], [0, 2, 3]]), {"material": "pec"}, "ground")],
        wires=wires,
        volumes=[SceneVolume(box, faces, CLOUD, "layer")],
        radar=replace(radar, **changes),
        film=film(extent),
        settings=TraceSettings(keep_subsets=False),
    )


@pytest.mark.parametrize(
    ("seed", "method"),
    [
        pytest.param(seed, method, marks=() if (seed, method) == (0, "hybrid") else pytest.mark.slow)
        for seed in range(12)
        for method in ("hybrid", "image")
        if method == "hybrid" or seed % 3 == 0
    ],
)
def test_a_cropped_image_of_volumes_and_wires_is_the_whole_ones_middle(seed: int, method: str) -> None:
    """The same scatterers in both: level and phase agree; folded, the level is off by decibels."""
    radar, _, _, rng = drawn(seed)
    if method == "image":
        radar = replace(radar, squint_angle_deg=0.0)  # one look stands for one aperture
    extent = float(rng.uniform(24.0, 32.0))
    images = []
    for size in (extent, 90.0):
        scene = layered(radar, size, 25.0)
        scene = replace(scene, settings=replace(scene.settings, method=method))
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", SarmitsubaWarning)  # of volumes beside the swath
            images.append(render(scene) if method == "image" else focus(simulate(scene)))
    cropped, whole = (middle(image, 0.3 * extent) for image in images)
    level = 10.0 * np.log10((np.abs(cropped) ** 2).mean() / (np.abs(whole) ** 2).mean())
    coherence = np.abs(np.vdot(cropped, whole)) / np.sqrt(
        (np.abs(cropped) ** 2).sum() * (np.abs(whole) ** 2).sum()
    )
    # tol: side lobes of what is beside, which the whole image has; over some 50 cells
    assert abs(level) < 0.2 and coherence > 0.995, (level, coherence)


def test_a_mover_beside_the_image_stays_where_its_range_rate_shows_it_in_it() -> None:
    radar, along, across, _ = drawn(0)
    radar = replace(radar, squint_angle_deg=0.0)
    still = build_scene(points=[PointTarget("aim", np.zeros(3))], radar=radar, film=film(60.0))
    line = -still.radar.track.center_position
    shift = 90.0
    speed = shift * 100.0 / np.linalg.norm(line) / (line @ across / np.linalg.norm(line))
    mover = PointTarget("car", shift * along, 100.0, motion=Motion(velocity=tuple(speed * across)))
    gone = PointTarget("parked", shift * along, 100.0)
    scene = build_scene(
        points=[PointTarget("aim", -20.0 * along, 1e-6), mover, gone], radar=radar, film=film(60.0)
    )
    raw = simulate(scene)
    image = focus(raw)
    assert [point["name"] for point in raw.metadata["points"]] == ["aim", "car"]
    peak = np.unravel_index(image.rcs().argmax(), image.grid.shape)
    assert (
        np.linalg.norm(image.grid.positions()[peak][:2]) < 3.0
    )  # tol: its range walks on during the aperture
    assert image.rcs().max() > 20.0  # tol: of 100 m^2; the walk blurs it


@pytest.mark.parametrize(
    "seed", [0, 1, *(pytest.param(seed, marks=pytest.mark.slow) for seed in range(2, 12))]
)
def test_a_ghost_that_a_low_prf_leaves_is_named_with_its_level(seed: int) -> None:
    """By the image itself: a point in it, and its ghost at half the pulses that it needs."""
    radar, along, _, rng = drawn(seed)
    prf = 2.0 * 100.0 / (299792458.0 / 5e9) * 50.0 / radar.slant_range  # ghosts 50 m apart
    place = float(rng.uniform(28.0, 40.0)) * along
    radar = replace(radar, prf=prf)
    with pytest.warns(SarmitsubaWarning) as said:
        scene = build_scene(points=[PointTarget("ship", place, 1e4)], radar=radar, film=film(100.0))
        image = focus(simulate(scene), range_window="rectangular", azimuth_window="rectangular")
    texts = [str(w.message) for w in said if 'point_scatterer "ship"' in str(w.message)]
    power, azimuth = image.rcs(), image.grid.azimuth
    row = int(np.unravel_index(power.argmax(), power.shape)[0])
    power[np.abs(azimuth - azimuth[row]) < 25.0] = 0.0
    ghost = float(10.0 * np.log10(power.max()))
    if ghost < 5.0 and not texts:  # the beam leaves nothing of it
        return
    (text,) = texts
    told = float(text.split("ghost of about ")[1].split(" dBsm")[0])
    assert told == pytest.approx(ghost, abs=2.0)  # tol: pixels, and where the processed band ends
    apart = float(text.split("in the image, ")[1].split(" m along")[0])
    at = azimuth[np.unravel_index(power.argmax(), power.shape)[0]] - azimuth[row]
    assert apart == pytest.approx(at, abs=4.0)  # tol: the ghost is a few cells wide


@pytest.mark.parametrize("seed", [0, 3])
def test_ground_lit_for_a_mover_beside_the_image_is_said_to_fold(seed: int) -> None:
    radar, along, across, _ = drawn(seed)
    radar = replace(radar, squint_angle_deg=0.0)
    square = np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
    faces = np.array([[0, 1, 2], [0, 2, 3]])
    ground = SceneMesh(300.0 * square, faces, {"material": "concrete", "smooth": True}, "ground")
    look = np.radians(radar.look_angle_deg)
    for shift, said in ((90.0, True), (0.0, False)):
        speed = shift * radar.speed / (radar.slant_range * np.sin(look))
        car = SceneMesh(
            square + shift * along + [0.0, 0.0, 1.0],
            faces,
            "metal",
            "car",
            motion=Motion(velocity=tuple(speed * across + 0.01 * along)),
        )
        scene = build_scene([ground, car], radar=radar, film=film(60.0))
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", SarmitsubaWarning)
            notes = check_folding(scene, launch_windows(scene))
        assert len(notes) == said
        if said:
            assert '("car")' in notes[0]
            prf = float(notes[0].split("raise prf to ")[1].split(" Hz")[0])
            raised = build_scene([ground, car], radar=replace(radar, prf=1.01 * prf), film=film(60.0))
            assert check_folding(raised, launch_windows(raised)) == []


def cropped_spotlight(seed: int, **changes: object) -> tuple[Scene, F64, float]:
    """A drawn small image seen by all pulses alike, and a point on its fade-out along the track; its place, its share.

    Seed 0 is an image of 22.5 cells whose ghost's peak lay a third of a cell outside it.
    """
    rng = np.random.default_rng([seed, 45])
    drawn_cells = (float(rng.uniform(12.0, 40.0)), float(rng.uniform(0.05, 0.95)))
    cells, beyond = drawn_cells if seed else (22.5, 0.717)
    heading = float(rng.uniform(0.0, 360.0)) if seed else 129.0
    side = ("left", "right")[rng.integers(2)] if seed else "left"
    h, azimuth = np.radians(heading), 1.5
    along = np.array([np.sin(h), np.cos(h), 0.0]) * (rng.choice([-1.0, 1.0]) if seed else 1.0)
    extent = cells * azimuth
    radar = RadarDescription(
        mode="spotlight",
        center_frequency=1.3e9,
        bandwidth=120e6,
        slant_range=3000.0,
        look_angle_deg=35.0,
        heading_deg=heading,
        look_side=side,
        azimuth_resolution=azimuth,
        aim_x=0.0,
        aim_y=0.0,
        aim_z=0.0,
    )
    place = (0.5 * extent + beyond * 10.0 * azimuth) * along
    points = [PointTarget("in", np.zeros(3), 1e-3), PointTarget("beside", place, 1000.0)]
    scene = build_scene(points=points, radar=replace(radar, **changes), film=film(extent))
    return scene, place, float(0.5 + 0.5 * np.cos(np.pi * beyond))


@pytest.mark.parametrize("seed", few_of(range(8), 2))
def test_the_main_lobe_of_a_ghost_stays_out_of_a_small_image(seed: int) -> None:
    """The far edge shows the side lobes that the bare sum over four times the pulses shows, and no main lobe."""
    scene, place, share = cropped_spotlight(seed)
    dense = denser(scene.radar)
    echoes = ideal_echoes(dense, np.stack([np.zeros(3), place]), np.array([1e-3, 1000.0 * share**2]))
    with warnings.catch_warnings():
        warnings.simplefilter("error", SarmitsubaWarning)  # nothing folds, nothing is said
        raw = simulate(scene)
    images = [focus(data, request=scene.image, focuser="backprojection").total() for data in (raw, echoes)]
    rows = slice(0, 6) if place @ scene.radar.track.along > 0.0 else slice(-6, None)
    error = float(np.abs(images[0][rows] - images[1][rows]).max() ** 2)
    # tol: side lobes of the ghost, eight cells off and more, against the point's own power
    assert error < 10.0**-3.3 * 1000.0 * share**2 + 1e-6, 10.0 * np.log10(error / (1000.0 * share**2))


def test_a_ghost_that_peaks_outside_is_named_where_its_main_lobe_reaches_in() -> None:
    said = {}
    scene, place, _ = cropped_spotlight(0)
    speed, wavelength = np.linalg.norm(scene.radar.track.velocity[0]), scene.radar.waveform.wavelength
    for outside in (0.3, 6.0):  # cells from the far edge to the ghost's peak
        apart = float(np.linalg.norm(place)) + 0.5 * scene.image.extent_azimuth + 1.5 * outside
        prf = float(2.0 * speed * apart / (wavelength * 3000.0))
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", SarmitsubaWarning)
            low, _, _ = cropped_spotlight(0, prf=prf)
            raw = simulate(low)
        said[outside] = [note for note in raw.metadata["notes"] if "leaves a ghost" in note]
        if outside == 0.3:
            image = focus(raw, range_window="rectangular", azimuth_window="rectangular").rcs()
            rows = image[:8] if place @ low.radar.track.along > 0.0 else image[-8:]
            (text,) = said[outside]
            told = float(text.split("ghost of about ")[1].split(" dBsm")[0])
            assert told == pytest.approx(10.0 * np.log10(rows.max()), abs=2.0)  # tol: pixels
    assert not said[6.0]


def test_an_image_beside_all_points_is_refused() -> None:
    radar, along, _, _ = drawn(0)
    scene = build_scene(points=[PointTarget("aim", np.zeros(3))], radar=radar, film=film(40.0))
    away = replace(scene, points=(PointTarget("far", 300.0 * along),))
    with pytest.raises(RadarError, match="shows none of the 1 ideal points, the nearest 280 m outside it"):
        simulate(away)


def test_a_scene_that_fits_its_image_keeps_its_pulses() -> None:
    """Points within the image, one of them high: no share, no note, no other prf."""
    radar, along, across, _ = drawn(2)
    points = [PointTarget("a", 10.0 * along), PointTarget("high", 25.0 * across + np.array([0.0, 0.0, 20.0]))]
    raw = simulate(build_scene(points=points, radar=radar, film=film(0.0)))
    assert not [note for note in raw.metadata["notes"] if "left out" in note]
    assert [point["rcs"] for point in raw.metadata["points"]] == [1.0, 1.0]
    assert isinstance(raw.radar.track, Track)


@pytest.mark.filterwarnings(
    "ignore::sarmitsuba.core.errors.SarmitsubaWarning"
)  # a plate beside a small image, on purpose
@pytest.mark.parametrize("across", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_hybrid_keeps_what_the_fade_out_lights(across: bool) -> None:
    """A plate that faces the radar beside an image of few cells: blocks of pulses against every pulse traced."""
    radar = RadarDescription(
        slant_range=1.5e3,
        look_angle_deg=40.0,
        heading_deg=90.0,
        bandwidth=300e6,
        azimuth_resolution=0.5,
        aim_x=0.0,
        aim_y=0.0,
        aim_z=0.0,
    )
    film = FilmDescription(
        image_extent_azimuth=8.0,
        image_extent_range=8.0,
        image_center_x=0.0,
        image_center_y=0.0,
        image_height=0.0,
    )
    level = np.array([[-30.0, -30.0, 0.0], [30.0, -30.0, 0.0], [30.0, 30.0, 0.0], [-30.0, 30.0, 0.0]])
    rough = {"material": "concrete", "rms_height": 0.004, "diffuse_law": "lambert", "diffuse_level_db": -20.0}
    bare = build_scene([SceneMesh(level, [[0, 1, 2], [0, 2, 3]], rough, "ground")], radar=radar, film=film)
    track = bare.radar.track
    look = track.center_position / np.linalg.norm(track.center_position)
    u, v = track.along, np.cross(look, track.along)
    place = (bare.radar.across if across else track.along) * 8.5 + [0.0, 0.0, 1.2]
    corners = place + np.array([-u - v, u - v, u + v, -u + v])
    plate = SceneMesh(corners, [[0, 1, 2], [0, 2, 3]], "pec", "plate")
    ground = SceneMesh(level, [[0, 1, 2], [0, 2, 3]], rough, "ground")
    scene = build_scene([ground, plate], radar=radar, film=film).replace(max_depth=1, ray_spacing=0.05)
    every, blocks = (simulate(scene.replace(method=method), seed=1).data for method in ("raw", "hybrid"))
    # tol: a plate's glint turns by a part of its lobe within a block of pulses
    assert np.linalg.norm(blocks - every) < 0.1 * np.linalg.norm(every)


def at_the_edge(seed: int, height: float, gap: float, behind: float = 24.0, look: float = 35.0) -> Scene:
    """A metal tower on wide ground, seen by a drawn radar, ``gap`` (m) from the near-range edge of its image.

    At look angles of ``look`` to 15 degrees more.
    """
    rng = np.random.default_rng([seed, 77])
    heading, side = float(rng.uniform(0.0, 360.0)), ("left", "right")[rng.integers(2)]
    h = np.radians(heading)
    along = np.array([np.sin(h), np.cos(h), 0.0])
    across = np.array([along[1], -along[0], 0.0]) * (1.0 if side == "right" else -1.0)
    axes = np.stack([along, across, [0.0, 0.0, 1.0]])
    vertices, faces = tessellate.cube()
    tower = (vertices * [1.0, 1.0, 0.5 * height] + [0.0, 0.0, 0.5 * height]) @ axes
    faces = faces if np.linalg.det(axes) > 0.0 else faces[:, ::-1]
    level = 60.0 * np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]) @ axes
    middle = 0.5 * (behind - gap) * across
    radar = RadarDescription(
        slant_range=2e4,
        look_angle_deg=float(look + rng.uniform(0.0, 15.0)),
        heading_deg=heading,
        look_side=side,
        center_frequency=5e9,
        bandwidth=400e6,
        azimuth_resolution=1.0,
        aim_x=0.0,
        aim_y=0.0,
        aim_z=0.0,
    )
    film = FilmDescription(
        image_extent_azimuth=16.0,
        image_extent_range=behind + gap,
        image_center_x=float(middle[0]),
        image_center_y=float(middle[1]),
        image_height=0.0,
        image_grid="ground",
    )
    ground = SceneMesh(
        level, np.array([[0, 1, 2], [0, 2, 3]]), {"material": "concrete", "smooth": True}, "ground"
    )
    scene = build_scene(
        [ground, SceneMesh(tower, faces, {"material": "metal", "smooth": True}, "tower")],
        radar=radar,
        film=film,
    )
    return scene.replace(max_depth=2, ray_spacing=0.15)


def foot(scene: Scene) -> tuple[C64, list[str]]:
    """Image about a tower's foot, and what the run says about ground in front of tall objects."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", SarmitsubaWarning)
        raw = simulate(scene)
    request = {"center_x": 0.0, "center_y": 0.0, "height": 0.0, "extent_azimuth": 5.0, "extent_range": 2.4}
    image = focus(raw, request=request | {"grid": "ground", "spacing_azimuth": 0.5, "spacing_range": 0.4})
    return image.total(), [note for note in raw.metadata["notes"] if "tall objects" in note]


@pytest.mark.parametrize(
    "seed", [0, 1, *(pytest.param(seed, marks=pytest.mark.slow) for seed in range(2, 12))]
)
def test_a_tower_at_the_near_edge_keeps_its_double_bounce(seed: int) -> None:
    """Against an image that reaches far beyond; the ground in front of the tower lies beside the small one."""
    rng = np.random.default_rng([seed, 78])
    height, gap = float(rng.uniform(4.0, 9.0)), float(rng.uniform(1.2, 4.0))
    small, notes = foot(at_the_edge(seed, height, gap))
    large, _ = foot(at_the_edge(seed, height, 30.0))
    assert not notes
    assert error_db(small, large) < -35.0  # tol: other places of the rays, 0.15 m apart


@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.slow)])
def test_ground_before_a_tower_too_tall_for_the_image_is_named(seed: int) -> None:
    scene, gap = at_the_edge(seed, 20.0, 1.5, 6.0, 45.0), 1.5
    small, (note,) = foot(scene)
    told = float(note.split("by up to ")[1].split(" dB")[0])
    wider = float(note.split("towards the radar by ")[1].split(" m")[0])
    large, _ = foot(at_the_edge(seed, 20.0, 50.0, 24.0, 45.0))
    lost = -10.0 * np.log10((np.abs(small) ** 2).sum() / (np.abs(large) ** 2).sum())
    assert lost == pytest.approx(told, abs=0.3)  # tol: shape of the taper, half of which counts as lit
    (window,) = launch_windows(scene)
    bare = launch_windows(scene.replace(max_depth=1))[0]
    assert window.half_x * window.half_y <= 1.2501 * bare.half_x * bare.half_y
    (enough,) = launch_windows(at_the_edge(seed, 20.0, gap + 1.01 * wider, 6.0, 45.0))
    assert enough.unlit[1] < 0.5


def test_nothing_tall_at_the_edge_leaves_the_window_as_it_was() -> None:
    """Low things near the edge, tall ones far from it or below the plane, one bounce, ground that ends at the image."""
    for height, gap in ((1.0, 4.0), (6.0, 12.0)):
        scene = at_the_edge(3, height, gap)
        (window,), (bare,) = launch_windows(scene), launch_windows(scene.replace(max_depth=1))
        assert np.array_equal(window.box, bare.box) and np.array_equal(window.center, bare.center)
        assert (window.half_x, window.half_y, window.taper) == (bare.half_x, bare.half_y, bare.taper)
    scene = at_the_edge(3, 8.0, 2.0)
    (window,), (bare,) = launch_windows(scene), launch_windows(scene.replace(max_depth=1))
    assert window.half_y > bare.half_y
    vertices = scene.geometry.vertices.copy()
    vertices[:4] *= 0.01  # the ground ends under the tower
    (ends,) = launch_windows(replace(scene, geometry=replace(scene.geometry, vertices=vertices)))
    assert ends.taper == 0.0 and ends.unlit == (0.0, 0.0)
