"""Labels of echoes: parts that add up to the image, closed forms of mechanisms, levels without speckle."""

from dataclasses import replace

import numpy as np
import pytest

from sarmitsuba.analysis.echo_labels import EchoLabels, boxes, echo_labels
from sarmitsuba.core.arrays import C64, F64, I64
from sarmitsuba.loading.build import SceneMesh, build_scene
from sarmitsuba.machine.backend import dr
from sarmitsuba.machine.exclusive import exclusive
from sarmitsuba.radar.description import RadarDescription
from sarmitsuba.radar.film import FilmDescription
from sarmitsuba.scene.scene import Scene
from sarmitsuba.scene.settings import TraceSettings
from sarmitsuba.signal.focusing import default_grid
from sarmitsuba.signal.focusing.look import adjoint_cells, form_image
from sarmitsuba.signal.image import ImageGrid
from sarmitsuba.simulation.execution.image import Imager
from sarmitsuba.simulation.execution.points import point_taps
from sarmitsuba.simulation.execution.recording import Recording
from sarmitsuba.simulation.execution.run import Run
from sarmitsuba.simulation.execution.tracing import AntennaStates
from sarmitsuba.tracing.kernel.path_groups import MECHANISMS
from sarmitsuba.tracing.kernel.state import COHERENT, RECIPROCAL
from tests.support.scenes import shipped

# float32 grids of parts and of the whole, in other orders of summation
SUMS_DB = -60.0


def grid_of(scene: Scene) -> ImageGrid:
    """Pixels that a scene asks for."""
    return default_grid(scene.radar, scene.image)


def whole_image(scene: Scene, seed: int | None = None) -> C64:
    """Image of one look without noise."""
    effects = {**scene.settings.effects, "noise": "off"}
    settings = replace(scene.settings, method="image", effects=effects, keep_subsets=False)
    if seed is not None:
        settings = replace(settings, seed=seed)
    run = Run(replace(scene, settings=settings))
    return Imager(run, range_window="taylor", azimuth_window="taylor").image().data


def error_db(found: C64, wanted: C64) -> float:
    """Energy of a difference over that of the second image, dB."""
    return float(20.0 * np.log10(np.linalg.norm(found - wanted) / np.linalg.norm(wanted) + 1e-30))


SMALL = {
    "azimuth_resolution": 1.0,
    "slant_range": 5000.0,
    "bandwidth": 150e6,
    "aim_x": 0.0,
    "aim_y": 0.0,
    "aim_z": 0.0,
}


def ground(extent: float, material: object) -> SceneMesh:
    """Level square about the origin."""
    a = 0.5 * extent
    corners = [[-a, -a, 0.0], [a, -a, 0.0], [a, a, 0.0], [-a, a, 0.0]]
    return SceneMesh(corners, [[0, 1, 2], [0, 2, 3]], material, "ground")


def box(x: float, y: float, size: F64, material: object, name: str, turn: float = 0.0) -> SceneMesh:
    """Upright box on the ground about (x, y), turned (rad)."""
    import trimesh

    mesh = trimesh.creation.box(size)
    c, s = np.cos(turn), np.sin(turn)
    place = np.array([[c, -s, 0.0, x], [s, c, 0.0, y], [0.0, 0.0, 1.0, 0.5 * size[2]], [0.0, 0.0, 0.0, 1.0]])
    return SceneMesh.of(mesh, material, name, to_world=place)


CLUTTER = {
    "material": "medium_dry_ground",
    "rms_height": 0.02,
    "diffuse_law": "lambert",
    "diffuse_level_db": -8.0,
}
CONCRETE = {"material": "concrete", "rms_height": 0.003, "diffuse_law": "lambert", "diffuse_level_db": -5.0}


def town(
    grid: str = "ground", polarisation: str = "HH,HV,VV", look: float = 40.0, n: int = 2, seed: int = 0
) -> Scene:
    """Drawn boxes on rough ground."""
    rng = np.random.default_rng([5, seed])
    meshes = [ground(60.0, CLUTTER)]
    for i in range(n):
        size = rng.uniform([3.0, 3.0, 2.0], [6.0, 6.0, 5.0])
        x, y = -12.0 + 24.0 * i / max(n - 1, 1), rng.uniform(-8.0, 8.0)
        meshes.append(box(x, y, size, CONCRETE, f"box {i}", rng.uniform(0.0, 0.3)))
    radar = RadarDescription(look_angle_deg=look, polarisation=polarisation, **SMALL)
    film = FilmDescription(image_grid=grid, image_extent_azimuth=40.0, image_extent_range=50.0)
    return build_scene(meshes, radar=radar, film=film, settings=TraceSettings(seed=seed))


SHIPPED = ("dihedral", "point", "railing")


@pytest.mark.parametrize("grid", ["ground", "slant"])
@pytest.mark.parametrize("name", SHIPPED)
@exclusive
def test_parts_of_shipped_scenes_add_up(name: str, grid: str) -> None:
    """The image of all groups is that of method image, and energies of groups add up to its energy."""
    check_sum(shipped(name).replace(image_grid=grid))


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", ["trihedral", "bridge", "street_trees", "plate_edges", "courtyard", "moving_cars"]
)
@exclusive
def test_parts_of_larger_shipped_scenes_add_up(name: str) -> None:
    """The same for scenes with volumes, edges, pairs and movement."""
    check_sum(shipped(name))


@pytest.mark.parametrize("grid", ["ground", "slant"])
@exclusive
def test_parts_of_drawn_scenes_add_up(grid: str) -> None:
    """The same for boxes on rough ground, in three channels."""
    check_sum(town(grid, seed=3))


def check_sum(scene: Scene) -> None:
    """Compare the sum of all parts with the image."""
    echoes = EchoLabels(scene, grid_of(scene), {})
    every = np.ones(echoes.owner.size, dtype=bool)
    image = echoes.groups.image(echoes.groups.cells(every))
    assert error_db(image, whole_image(scene)) < SUMS_DB
    energy = echoes.groups.energies(image)
    whole = float(np.square(np.abs(image)).sum())
    assert energy.sum() == pytest.approx(whole, rel=1e-6 + 10.0 ** (0.1 * SUMS_DB))
    one = np.zeros_like(image)
    for _, wanted in echoes.parts(echoes.shape):
        one += echoes.groups.image(echoes.groups.cells(wanted))
    assert error_db(one, image) < SUMS_DB


@exclusive
def test_image_formation_has_its_adjoint() -> None:
    """Both sides of the definition of an adjoint, for drawn cells and pixels."""
    scene = shipped("point")
    imager = Imager(Run(replace(scene, settings=replace(scene.settings, method="image"))))
    look, rng = imager.look, np.random.default_rng(1)
    shape = (1, look.grid.n_range, look.grid.n_azimuth)
    cells = rng.standard_normal((*shape, 2)).astype(np.float32).view(np.complex64)[..., 0]
    pixels = rng.standard_normal((1, *look.image.shape, 2)).astype(np.float32).view(np.complex64)[..., 0]
    one = np.vdot(pixels, form_image(cells, look, scene.radar))
    other = np.vdot(adjoint_cells(pixels, look, scene.radar), cells)
    assert abs(one - other) < 1e-4 * np.linalg.norm(pixels) * np.linalg.norm(
        form_image(cells, look, scene.radar)
    )


def test_dihedral_is_a_double_bounce_of_wall_and_ground() -> None:
    """At the brightest pixel nearly all power is wall and ground, and it is the wall's."""
    scene = shipped("dihedral")
    layers, instances, _ = echo_labels(scene, grid_of(scene), {})
    energy = layers["mechanism_energy"].values
    peak = np.unravel_index(int(energy.sum(axis=-1).argmax()), energy.shape[:2])
    assert MECHANISMS[layers["mechanism"].values[peak] - 1] == "wall and ground"
    # single bounces lie 40 dB lower
    assert layers["mechanism_share"].values[peak] > 0.999
    by_name = {instance.name: instance for instance in instances}
    assert layers["instance"].values[peak] == by_name["wall"].number
    assert by_name["wall"].energy_share == pytest.approx(1.0, abs=0.01)
    # half of each plate's sides is seen: both plates face the antenna, seen from one side
    assert by_name["wall"].visible_share == pytest.approx(1.0, abs=0.01)


@pytest.mark.slow
def test_trihedral_is_a_triple_bounce() -> None:
    """At the brightest pixel nearly all power has three bounces."""
    scene = shipped("trihedral")
    layers, _, _ = echo_labels(scene, grid_of(scene), {})
    energy = layers["mechanism_energy"].values
    peak = np.unravel_index(int(energy.sum(axis=-1).argmax()), energy.shape[:2])
    assert MECHANISMS[layers["mechanism"].values[peak] - 1] == "triple bounce"
    assert layers["mechanism_share"].values[peak] > 0.95


@pytest.mark.slow
def test_the_three_lines_of_the_bridge_are_the_bridge() -> None:
    """Single, double and triple echo of the face over water belong to it, also where only water lies."""
    scene = shipped("bridge")
    grid = grid_of(scene)
    layers, instances, _ = echo_labels(scene, grid, {"fascia": "bridge", "road": "bridge", "river": "water"})
    fascia = next(i for i in instances if i.name == "fascia")
    look = np.radians(35.0)
    flat = grid.positions_on_line(grid.shape[0] // 2)[:, 0]
    # from the point below the edge, on the ground: the three images of the face, heights of its middle 29.5 m
    mirrored = ("diffuse after mirror",)
    for order, mechanisms in ((-1, ("diffuse",)), (0, (*mirrored, "wall and ground")), (1, mirrored)):
        place = order * 29.5 * np.cos(look) / np.sin(look)
        columns = np.flatnonzero(np.abs(flat - place) < 1.0)
        rows = slice(grid.shape[0] // 4, 3 * grid.shape[0] // 4)
        whose = layers["instance"].values[rows][:, columns]
        assert np.mean(whose == fascia.number) > 0.5, order
        bright = layers["mechanism"].values[rows][:, columns][whose == fascia.number]
        names = [MECHANISMS[i - 1] for i in bright]
        assert np.mean([name in mechanisms for name in names]) > 0.9, order
        kind = layers["class"].values[rows][:, columns]
        assert np.mean(kind == 1) > 0.5


@pytest.mark.parametrize(
    "seed", [1, pytest.param(2, marks=pytest.mark.slow), pytest.param(3, marks=pytest.mark.slow)]
)
def test_energies_are_those_of_the_shapes_alone(seed: int) -> None:
    """Shares of two boxes beside each other, without ground, against images with each of them alone."""
    both, one, other = boxes_alone(seed)
    layers, instances, _ = echo_labels(both, grid_of(both), {})
    alone = [float(np.square(np.abs(whole_image(s))).sum()) for s in (one, other)]
    share = [i.energy_share for i in instances]
    assert sum(share) == pytest.approx(1.0, abs=1e-5)
    # sampling error of the rays of two runs, -30 dB, against each energy; windows of rays differ
    for i in range(2):
        assert share[i] == pytest.approx(alone[i] / sum(alone), abs=0.05)
    assert np.all(layers["instance_share"].values <= 1.0 + 1e-6)


def boxes_alone(seed: int) -> tuple[Scene, Scene, Scene]:
    """Two drawn boxes, and scenes of each of them."""
    rng = np.random.default_rng([9, seed])
    meshes = [
        box(x, rng.uniform(-5.0, 5.0), rng.uniform(2.0, 5.0, 3), CONCRETE, f"box {i}", rng.uniform(0.0, 1.5))
        for i, x in enumerate((-12.0, 12.0))
    ]
    radar = RadarDescription(look_angle_deg=45.0, polarisation="VV", **SMALL)
    film = FilmDescription(image_extent_azimuth=40.0, image_extent_range=50.0)
    settings = TraceSettings(endless_ground="off", effects={"noise": "off"})
    made = [
        build_scene(some, radar=radar, film=film, settings=settings)
        for some in (meshes, meshes[:1], meshes[1:])
    ]
    return made[0], made[1], made[2]


BEAM = {"pattern": "rectangular", "antenna_length": 2.0, "antenna_height": 0.05}


@pytest.mark.parametrize(
    "look, mode, beam, looks",
    [
        *((look, mode, {}, 1) for look in (25.0, 40.0, 60.0) for mode in ("spotlight", "stripmap")),
        *((40.0, mode, BEAM, 2) for mode in ("stripmap", "sliding_spotlight")),
    ],
)
def test_mean_level_of_ground_is_that_of_its_law(
    look: float, mode: str, beam: dict[str, object], looks: int
) -> None:
    """Level ground of a Lambert law: sigma0 = level cos^2 of the incidence angle, and a tenth of it in HV.

    Where the beam moves over the image, several looks share every scatterer.
    """
    radar = RadarDescription(mode=mode, look_angle_deg=look, polarisation="HH,HV,VV", **SMALL, **beam)
    film = FilmDescription(image_extent_azimuth=30.0, image_extent_range=30.0)
    material = {**CLUTTER, "rms_height": 0.1, "cross_polar_ratio_db": -10.0}
    settings = TraceSettings(endless_ground="off")
    scene = build_scene([ground(120.0, material)], radar=radar, film=film, settings=settings)
    assert EchoLabels(scene, grid_of(scene), {}).imager.look.grid.n_looks >= looks
    layers, _, _ = echo_labels(scene, grid_of(scene), {})
    sigma0 = layers["expected_sigma0"].values
    wanted = 10.0 ** (-0.8) * np.cos(np.radians(look)) ** 2 * np.array([1.0, 0.1, 1.0])
    # nodes of a lattice, of slightly different numbers in each resolution cell; the incidence angle over the image
    assert sigma0.mean(axis=(0, 1)) == pytest.approx(wanted, rel=0.01)
    assert np.all(sigma0.std(axis=(0, 1)) < 0.03 * wanted)


@exclusive
def test_parts_of_a_strip_of_several_looks_add_up() -> None:
    """Boxes along a strip over which the beam moves: several looks, divided between neighbours."""
    radar = RadarDescription(look_angle_deg=40.0, polarisation="VV", **SMALL, **BEAM)
    film = FilmDescription(image_extent_azimuth=400.0, image_extent_range=40.0)
    meshes = [box(0.0, y, np.array([4.0, 6.0, 3.0]), CONCRETE, f"box at {y}") for y in (-150.0, 10.0, 140.0)]
    scene = build_scene(meshes, radar=radar, film=film)
    assert EchoLabels(scene, grid_of(scene), {}).imager.look.grid.n_looks > 1
    check_sum(scene)


@pytest.mark.slow
@pytest.mark.parametrize("polarisation", ["VV", "HH,HV,VV"])
def test_mean_level_is_the_mean_over_seeds(polarisation: str) -> None:
    """Mean power of 200 realisations of drawn boxes on rough ground, within three standard errors."""
    scene = town(polarisation=polarisation, n=1, seed=4)
    scene = replace(scene, settings=replace(scene.settings, effects={"noise": "off"}))
    grid = grid_of(scene)
    with_labels = echo_labels(scene, grid, {})[0]["expected_sigma0"].values
    run = EchoLabels(scene, grid, {})
    area = run.imager.pack(np.zeros((with_labels.shape[2], *grid.shape), np.complex64)).cell_area
    n = 200
    total, square = 0.0, 0.0
    for seed in range(n):
        power = np.square(np.abs(whole_image(scene, seed)), dtype=np.float64) / area
        # blocks of 5 x 5 pixels
        power = blocks(power)
        total, square = total + power, square + power**2
    mean = total / n
    deviation = np.sqrt(np.maximum(square / n - mean**2, 0.0) / n)
    wanted = blocks(np.moveaxis(with_labels, -1, 0).astype(np.float64))
    # the whole: sampling error of the rays, and of HV, which mirrored paths of few scatterers make
    whole = mean.sum(axis=(1, 2)) / wanted.sum(axis=(1, 2)) - 1.0
    for channel, total_error in zip(scene.radar.channels, whole, strict=True):
        assert abs(total_error) < (0.02 if channel[0] == channel[1] else 0.06), channel
    # blocks of 25 pixels, where the level is within 30 dB of the strongest: three standard errors and 5 % for the rays.
    # at the feet of walls a scatterer returns over several paths that are correlated, which the level ignores
    for i in range(len(mean)):
        if scene.radar.channels[i] == "HV":
            continue
        strong = wanted[i] > 1e-3 * wanted[i].max()
        off = np.abs(mean[i] - wanted[i]) < 3.0 * deviation[i] + 0.05 * wanted[i]
        assert float(np.mean(off[strong])) > 0.96
        assert abs(float(np.median(mean[i][strong] / wanted[i][strong])) - 1.0) < 0.01


def blocks(power: F64) -> F64:
    """Means over blocks of 5 x 5 pixels."""
    n, rows, columns = power.shape
    part = power[:, : rows // 5 * 5, : columns // 5 * 5]
    return part.reshape(n, rows // 5, 5, columns // 5, 5).mean(axis=(2, 4))


@pytest.mark.parametrize("seed", range(3))
def test_oriented_boxes_of_drawn_rectangles(seed: int) -> None:
    """The smallest rectangle about a drawn one has its sides, to the size of a pixel."""
    rng = np.random.default_rng(seed)
    middle, half, turn = rng.uniform(45.0, 55.0, 2), rng.uniform(8.0, 25.0, 2), rng.uniform(0.0, np.pi)
    row, column = np.mgrid[:100, :100]
    u = (row - middle[0]) * np.cos(turn) + (column - middle[1]) * np.sin(turn)
    v = (column - middle[1]) * np.cos(turn) - (row - middle[0]) * np.sin(turn)
    where = (np.abs(u) < half[0]) & (np.abs(v) < half[1])
    found, oriented, pixels = boxes(where)
    assert pixels == where.sum()
    rows, columns = np.nonzero(where)
    assert found == (rows.min(), columns.min(), rows.max(), columns.max())
    sides = sorted(np.linalg.norm(np.diff(oriented[:3], axis=0), axis=1))
    assert sides == pytest.approx(sorted(2.0 * half), abs=2.5)
    assert boxes(np.zeros((4, 4), bool))[0] == (-1, -1, -1, -1)


@pytest.mark.parametrize("mode", ["spotlight", "stripmap"])
@exclusive
def test_powers_of_a_part_are_those_of_its_whole_image(mode: str) -> None:
    """A box in a wide image, on the pixels about it only: what is left out is side lobes 64 cells away."""
    radar = RadarDescription(mode=mode, look_angle_deg=40.0, polarisation="HH,VV", **SMALL)
    film = FilmDescription(image_extent_azimuth=250.0, image_extent_range=450.0)
    rng = np.random.default_rng(6)
    meshes = [box(x, 0.0, rng.uniform(2.0, 5.0, 3), CONCRETE, f"box at {x}") for x in (-150.0, 40.0)]
    scene = build_scene(meshes, radar=radar, film=film)
    echoes = EchoLabels(scene, grid_of(scene), {})
    for _, wanted in echoes.parts(echoes.shape):
        whole = np.square(np.abs(echoes.groups.image(echoes.groups.cells(wanted)))).sum(axis=0)
        where, power, near = echoes.groups.powers_of(wanted, 1e-6)
        assert power.size < 0.8 * whole.size
        found = np.zeros_like(whole)
        found[where] = power
        assert np.abs(found - whole).sum() < 5e-4 * whole.sum()
        assert np.abs(found - whole).max() < 1e-5 * whole.max()
        # almost all energy lies at the echoes
        assert power[near].sum() > 0.9 * whole.sum()


@pytest.mark.parametrize(
    "seed", [1, pytest.param(2, marks=pytest.mark.slow), pytest.param(3, marks=pytest.mark.slow)]
)
@exclusive
def test_groups_are_those_of_recorded_chains(seed: int) -> None:
    """Owners and mechanisms from every path's recorded chain of hits in NumPy, and its sums spread one by one."""
    scene = town(n=3, seed=seed, polarisation="HH,VV")
    echoes = EchoLabels(scene, grid_of(scene), {})
    imager, look = echoes.imager, echoes.imager.look
    assert imager.sampling is not None and look.grid.n_looks == 1
    tracer = imager.run.tracer(imager.sampling, antenna_pattern=False)
    states = AntennaStates(look.grid.position, look.grid.velocity, slice(0, 1))
    geometry = imager.run.scene.geometry
    corners = geometry.vertices[geometry.faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    upward = np.abs(normal[:, 2]) / np.linalg.norm(normal, axis=1)
    mesh = np.where(geometry.face_mesh < len(scene.geometry.mesh_names), geometry.face_mesh, 0)
    wanted: dict[tuple[int, str], C64] = {}
    for launch in tracer.launches(imager.rays(0)[0], 1):
        recording = Recording(launch.part.rays, 2, (2_000_000, 1_000_000))
        _, state = launch.record(
            tracer.kernel_of(launch.part.grid, states, recording), scene.radar.antenna, recording
        )
        dr.eval(state, recording.memory)
        assert recording.whole
        rows = recording.rows()
        kind, order = rows.labels[:, 1].astype(int), rows.labels[:, 2].astype(int)
        turn = np.where(kind == RECIPROCAL, (order + 1) // 2, order)
        _, chain = rows.chains(turn)
        face = np.where(chain >= 0, tracer.trace_scene.geometry_faces[np.maximum(chain, 0)], -1)
        keys = [
            _named_group(f[f >= 0], mesh, upward, k, o) for f, k, o in zip(face, kind, order, strict=True)
        ]
        for key in set(keys):
            pick = np.array([other == key for other in keys])
            r, s = rows.lengths[pick, 0], rows.lengths[pick, 1]
            amplitude = rows.amplitudes[pick].T.astype(np.complex128)
            taps = point_taps(look.grid, 0, r, s, amplitude, scene.radar.waveform.wavelength)
            part = np.stack([taps.on(look.grid, values) for values in taps.values])
            wanted[key] = wanted.get(key, np.zeros_like(part)) + part
    whole = np.linalg.norm(sum(wanted.values()))
    seen = set()
    for group in echoes.groups.present.tolist():
        key = (int(echoes.shape[group]), MECHANISMS[int(echoes.mechanism[group])])
        found = echoes.groups.cells(np.arange(echoes.owner.size) == group)
        assert np.linalg.norm(found - wanted[key]) < 1e-4 * whole, key
        seen.add(key)
    # tiles hold the echoes in the grid; what the table has beside them lies outside of it
    assert all(not np.any(part) for key, part in wanted.items() if key not in seen)
    assert {"diffuse", "diffuse after mirror", "single bounce"} <= {name for _, name in seen}
    assert len({shape for shape, _ in seen}) == 4


def _named_group(faces: I64, mesh: I64, upward: F64, kind: int, order: int) -> tuple[int, str]:
    """Shape and mechanism of a chain of faces; shape 0 is the ground."""
    shapes = mesh[faces].tolist()
    owner = next((shape for shape in reversed(shapes) if shape), 0)
    if kind != COHERENT:
        return owner, "diffuse" if order == 1 else "diffuse after mirror"
    level = any(
        shape == 0 or upward[f] > np.cos(np.radians(30.0)) for f, shape in zip(faces, shapes, strict=True)
    )
    wall = any(shape and upward[f] < 0.5 for f, shape in zip(faces, shapes, strict=True))
    names = {
        1: "single bounce",
        2: "wall and ground" if level and wall else "double bounce",
        3: "triple bounce",
    }
    return owner, names.get(order, "multiple bounces")


def test_scenes_that_one_look_cannot_show_say_so() -> None:
    """A track round the scene: no labels of echoes, and one line with the reason."""
    given = {name: value for name, value in SMALL.items() if name != "azimuth_resolution"}
    radar = RadarDescription(
        mode="circular", mode_parameters={"arc_deg": 360.0}, look_angle_deg=40.0, **given
    )
    film = FilmDescription(image_extent_azimuth=10.0, image_extent_range=10.0)
    scene = build_scene([ground(60.0, CLUTTER)], radar=radar, film=film)
    layers, instances, notes = echo_labels(scene, grid_of(scene), {})
    assert not layers and not instances
    assert len(notes) == 1 and "left out" in notes[0] and "method" in notes[0]


def test_classes_decide_what_is_ground() -> None:
    """A wall called ground leaves its double bounce to the floor, which is called a building."""
    scene = shipped("dihedral")
    layers, instances, _ = echo_labels(scene, grid_of(scene), {"floor": "building", "wall": "ground"})
    assert [i.semantic_class for i in instances] == ["building", "ground"]
    assert instances[0].energy_share > 0.99
    names = layers["class"].codes
    power = layers["mechanism_energy"].values.sum(axis=-1)
    peak = np.unravel_index(int(power.argmax()), power.shape)
    assert names[int(layers["class"].values[peak])] == "building"
