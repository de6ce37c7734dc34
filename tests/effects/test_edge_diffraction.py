"""Fringe currents of metal edges: coefficients in float32, levels of plates, what is seen of them, reciprocity."""

from collections.abc import Iterator
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import trimesh

from sarmitsuba import RadarDescription, Scene, SceneMesh, build_scene, load_scene, simulate
from sarmitsuba.core.arrays import C64, C128, F64
from sarmitsuba.core.constants import SPEED_OF_LIGHT
from sarmitsuba.effects.plan import plan_effects
from sarmitsuba.machine.backend import dr, ensure_backend, mi
from sarmitsuba.radar.film import FilmDescription
from sarmitsuba.scene.geometry import Geometry
from sarmitsuba.scene.materials.material import Material
from sarmitsuba.scene.mesh.sharp_edges import DIRECTIONS, SharpEdges, sharp_edges
from sarmitsuba.simulation.execution.rcs import RcsResult, monostatic_rcs
from sarmitsuba.simulation.execution.turntable import Aspects, rcs_sweep
from sarmitsuba.simulation.planning.pilot import plan_scene
from sarmitsuba.tracing.kernel.source import PointSource
from sarmitsuba.tracing.scatterers.edges.diffraction import LONGEST, FringeCurrents, edges_of
from sarmitsuba.tracing.scatterers.edges.edge_currents import LEAST
from sarmitsuba.truth import theory
from sarmitsuba.truth.validation import targets
from tests.support.draws import few_of
from tests.support.unweighted import focus

# the plates' own notes that they are black but for their edges
pytestmark = pytest.mark.filterwarnings("ignore:.*no material has a diffuse law")
WAVELENGTH = 0.03
FREQUENCY = 299792458.0 / WAVELENGTH
SHIPPED = ("plate_edges", "plate", "dihedral", "trihedral", "trihedral_square", "sphere", "point")
STRIP, DEPTH = 2.0, 24.0
BOX = trimesh.creation.box(extents=(0.2, 0.3, 0.4))
SIDES = ((-1, -1), (1, -1), (1, 1), (-1, 1))


def edges_in(geometry: Geometry) -> SharpEdges:
    ensure_backend()
    return edges_of(geometry, 2 * targets.PEC, WAVELENGTH)


def traced(
    geometry: Geometry, looks: F64, channels: tuple[str, ...] = ("HH", "HV", "VH", "VV"), order: int = 1
) -> RcsResult:
    source = PointSource(FringeCurrents(edges_in(geometry)), order)
    return monostatic_rcs(geometry, targets.PEC, looks, FREQUENCY, channels=channels, sources=(source,))


# ---- coefficients


class Drawn:
    """Wedges, both directions and polarisations at random, at points of the exterior."""

    def __init__(self, seed: int, n: int, backscatter: bool) -> None:
        rng = np.random.default_rng(seed)
        self.n = n
        self.angle = np.where(rng.random(n) < 0.4, 2.0, rng.uniform(1.05, 2.0, n))
        self.inward = rng.normal(size=(n, 3))
        self.inward /= np.linalg.norm(self.inward, axis=1, keepdims=True)
        self.normal = np.cross(self.inward, rng.normal(size=(n, 3)))
        self.normal /= np.linalg.norm(self.normal, axis=1, keepdims=True)
        self.source, self.observer = self.direction(rng), self.direction(rng)
        if backscatter:
            self.observer = self.source
        self.field, self.receive = (self.across(rng, u) for u in (self.source, self.observer))

    def direction(self, rng: np.random.Generator) -> F64:
        phi, along = rng.uniform(0.0, self.angle * np.pi), rng.uniform(-1.0, 1.0, self.n)
        rest = np.sqrt(1.0 - along**2)
        edge = np.cross(self.inward, self.normal)
        parts = (rest * np.cos(phi), rest * np.sin(phi), along)
        return sum(a[:, None] * u for a, u in zip(parts, (self.inward, self.normal, edge), strict=True))

    def across(self, rng: np.random.Generator, u: F64) -> C128:
        e = rng.normal(size=(self.n, 3)) + 1j * rng.normal(size=(self.n, 3))
        e -= u * np.sum(u * e, axis=1, keepdims=True)
        return e / np.linalg.norm(e, axis=1, keepdims=True)

    def wedges(self) -> Iterator[theory.WedgeFrame]:
        return (theory.WedgeFrame(*w) for w in zip(self.angle, self.inward, self.normal, strict=True))

    def kernel(self, length: float, wavelength: float = WAVELENGTH, sheet: int | None = None) -> C128:
        """What the scatterers return; ``sheet``: index of an edge behind which a sheet is ten wavelengths wide."""
        ensure_backend()
        faces = [wedge.faces for wedge in self.wedges()]
        inward, normal = (np.array([[face[i] for face in pair] for pair in faces]) for i in (0, 1))
        one = np.ones(self.n)
        span = np.full((self.n, DIRECTIONS), np.inf)
        if sheet is not None:
            span[sheet] = 10.0 * wavelength
        edges = SharpEdges(
            np.zeros((self.n, 3)),
            length * one,
            self.angle,
            inward,
            normal,
            one,
            span,
            -one,
            0.0 * one,
            np.ones((self.n, 2)),
        )
        constants = SimpleNamespace(wavenumber=mi.Float(2.0 * np.pi / wavelength))
        got = FringeCurrents(edges).amplitude(
            SimpleNamespace(constants=constants),
            dr.arange(mi.UInt32, self.n),
            SimpleNamespace(to_antenna=vector(self.source)),
            SimpleNamespace(to_antenna=vector(self.observer)),
            (vector(self.field.real), vector(self.field.imag)),
            (vector(self.receive.real), vector(self.receive.imag)),
        )
        return np.asarray(got.real) + 1j * np.asarray(got.imag)

    def outside(self) -> F64:
        """Share of wedges that a direction grazes within a thousandth."""
        shares = []
        for u in (self.source, self.observer):
            across, off = np.sum(u * self.inward, axis=1), np.sum(u * self.normal, axis=1)
            phi = np.arctan2(off, across) % (2.0 * np.pi)
            inside = np.minimum(phi, self.angle * np.pi - phi)
            shares.append(np.clip(0.5 + 0.5 * inside / LEAST, 0.0, 1.0))
        return np.where(self.angle < 2.0, np.minimum(*shares), 1.0)

    def closed(self) -> C128:
        """The same by the closed form in float64, per metre."""
        ways = zip(self.source, self.observer, self.field, self.receive, strict=True)
        return np.array(
            [
                0.5 * (theory.fringe_strip(w, a, b, e, q) + theory.fringe_strip(w, b, a, q, e))
                for w, (a, b, e, q) in zip(self.wedges(), ways, strict=True)
            ]
        )


def vector(rows: F64) -> mi.Vector3f:
    return mi.Vector3f(*(mi.Float(np.ascontiguousarray(c)) for c in rows.T.astype(np.float32)))


@pytest.mark.parametrize(
    ("seed", "backscatter"),
    [(1, True), (3, False), *(pytest.param(n, n < 13, marks=pytest.mark.slow) for n in range(11, 15))],
)
def test_drawn_wedges_in_float32(seed: int, backscatter: bool) -> None:
    drawn = Drawn(seed, 400, backscatter)
    got, want = drawn.kernel(1e-9) * 1e9, drawn.closed() * drawn.outside()
    error = np.abs(got - want) / np.maximum(np.abs(want), 1.0)
    # tol: float32, some 20 roundings; cotangents within 0.2 rad of a pole that is left are that much larger
    whole = drawn.outside() == 1.0
    assert error[whole].max() < 1e-5
    # tol: an angle's rounding over the passage at a grazed face, 4e-7 of 2e-3
    assert error.max() < 2e-4


def test_reciprocal_both_ways() -> None:
    drawn = Drawn(5, 300, False)
    there = drawn.kernel(0.02)
    drawn.source, drawn.observer = drawn.observer, drawn.source
    drawn.field, drawn.receive = drawn.receive, drawn.field
    # tol: the same sums in another order
    assert np.abs(drawn.kernel(0.02) - there).max() < 1e-6 * np.abs(there).max()


def test_finite_on_every_boundary() -> None:
    """Along the faces, along the edge, where a facet mirrors, straight on: exactly there in float32."""
    angles = np.radians([0.0, 45.0, 90.0, 135.0, 180.0, 225.0, 270.0])
    flat = np.stack([np.cos(angles), np.sin(angles), 0.0 * angles], axis=1)
    along = np.array([[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]])
    tilted = np.sqrt(0.5) * (flat + along[0])
    ways = np.concatenate([flat, tilted, along])
    for exterior in (1.5, 2.0):
        one = Drawn(6, len(ways) ** 2, False)
        one.angle = np.full(one.n, exterior)
        one.inward, one.normal = np.tile([1.0, 0.0, 0.0], (one.n, 1)), np.tile([0.0, 1.0, 0.0], (one.n, 1))
        one.source, one.observer = (np.reshape(x, (-1, 3)) for x in np.broadcast_arrays(ways[:, None], ways))
        rng = np.random.default_rng(7)
        one.field, one.receive = (one.across(rng, u) for u in (one.source, one.observer))
        got = one.kernel(1e-9) * 1e9
        assert np.isfinite(got).all()
        back = (one.source == one.observer).all(axis=1)
        # backscatter has no infinity: coefficients of order one
        assert np.abs(got[back]).max() < 3.0
        # forward of a grazing wave the theory is infinite; elsewhere a boundary is at least 45 degrees off
        forward = np.sum(one.source * one.observer, axis=1) < -1.0 + 1e-6
        assert np.abs(got[~forward & ~back]).max() < 20.0


# ---- edges of a mesh


@pytest.mark.parametrize("seed", few_of(range(3)))
def test_longer_pieces_return_the_same(seed: int) -> None:
    """Edges of a drawn box far away, in pieces of two wavelengths and of up to eleven; shadows left out."""
    ensure_backend()
    rng = np.random.default_rng(seed)
    body = trimesh.creation.box(extents=rng.uniform(0.5, 2.0, 3))
    body.apply_transform(trimesh.transformations.random_rotation_matrix(rng.random(3)))
    geometry = targets.geometry([(body.vertices, body.faces)])
    spacing = float(rng.uniform(3.0, 11.0)) * WAVELENGTH
    few, many = (edges_of(geometry, 2 * targets.PEC, WAVELENGTH, spacing=apart) for apart in (spacing, 0.0))
    assert few.length.max() <= spacing + 1e-12
    assert few.n < 0.8 * many.n
    looks = rng.normal(size=(20, 3))
    looks /= np.linalg.norm(looks, axis=1, keepdims=True)
    got, want = (np.array([from_afar(edges, look) for look in looks]) for edges in (few, many))
    # tol: float32 phases within pieces up to 0.33 m long
    assert np.abs(got - want).max() < 1e-4 * np.abs(want).max()


def from_afar(edges: SharpEdges, look: F64) -> complex:
    """Sum over all pieces of edges, with the electric field across the line of sight."""
    field = np.cross(look, [0.3, 0.5, 0.7])
    constants = SimpleNamespace(wavenumber=mi.Float(2.0 * np.pi / WAVELENGTH))
    leg = SimpleNamespace(to_antenna=vector(look[None]))
    e = (vector(field[None]), vector(0.0 * field[None]))
    number = dr.arange(mi.UInt32, edges.n)
    got = FringeCurrents(edges).amplitude(SimpleNamespace(constants=constants), number, leg, leg, e, e)
    phase = np.exp(4j * np.pi / WAVELENGTH * (edges.middle @ look))
    return complex(np.sum((np.asarray(got.real) + 1j * np.asarray(got.imag)) * phase))


def test_kernels_without_rims_of_sheets_have_no_waves_along_them() -> None:
    ensure_backend()
    drawn = Drawn(5, 400, backscatter=False)
    rim = int(np.flatnonzero(drawn.angle == 2.0)[0])
    found, operations = [], []
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        for sheet in (None, rim):
            dr.kernel_history_clear()
            found.append(drawn.kernel(0.5 * WAVELENGTH, sheet=sheet))
            history = dr.kernel_history([dr.KernelType.JIT])
            operations.append(max(entry["operation_count"] for entry in history))
    without, with_sheet = found
    assert operations[0] < 0.9 * operations[1]
    others = np.arange(drawn.n) != rim
    np.testing.assert_array_equal(without[others], with_sheet[others])
    assert without[rim] != with_sheet[rim]


def test_edges_of_bodies() -> None:
    plate, box = targets.plate(0.3, 0.2, triangles=40), BOX
    rims = edges_in(plate)
    assert rims.length.sum() == pytest.approx(1.0) and (rims.angle == 2.0).all()
    assert rims.length.max() <= LONGEST * WAVELENGTH + 1e-12
    wedges = sharp_edges(box.triangles, np.ones(12, dtype=bool))
    assert wedges.length.sum() == pytest.approx(3.6) and np.allclose(wedges.angle, 1.5)
    outward = -wedges.inward.sum(axis=1)
    assert (np.einsum("ni,ni->n", outward, wedges.middle) > 0.0).all()
    # every facet of a smooth body is flat, its bends stand for its curvature
    assert not edges_in(targets.sphere(0.3, 1e-3)).n
    barrel = edges_in(targets.geometry([targets.cylinder_mesh(0.1, -0.2, 0.2, 1e-3)]))
    assert np.allclose(np.abs(barrel.middle[:, 2]), 0.2) and np.allclose(barrel.angle, 2.0)


def test_covered_edges_are_none() -> None:
    """The foot of a wall on the ground, a T-junction within a plate, a box's lower edges; dielectrics have none."""
    wall = targets.wall_and_ground(0.3, 0.4, 1.0)
    low = edges_in(wall)
    on_ground = np.abs(low.middle[:, 2]) < 1e-9
    # ground's own rims but for the seam with the wall, of which 0.4 m is shared, and the wall's other three sides
    assert low.length[on_ground].sum() == pytest.approx(0.4 + 2.4)
    assert low.length[~on_ground].sum() == pytest.approx(0.4 + 0.6)
    coarse = targets.parallelogram([0, 0, 0], [0.4, 0, 0], [0, 0.2, 0])
    fine = targets.parallelogram([0, -0.2, 0], [0.4, 0, 0], [0, 0.2, 0], triangles=64)
    assert edges_in(targets.geometry([coarse, fine])).length.sum() == pytest.approx(1.6)
    box = trimesh.creation.box(extents=(0.2, 0.2, 0.2)).apply_translation([0.0, 0.0, 0.1])
    ground = targets.parallelogram([-1, -1, 0], [2, 0, 0], [0, 2, 0])
    standing = edges_in(targets.geometry([(box.vertices, box.faces), ground]))
    upper = standing.of(standing.middle[:, 2] > 0.0)
    assert upper.length.sum() == pytest.approx(8 * 0.2)
    assert standing.length.sum() == pytest.approx(8 * 0.2 + 8.0)
    assert not edges_of(wall, (targets.BLACK, targets.BLACK), WAVELENGTH).n


# ---- levels


@pytest.mark.parametrize("seed", [21, 22])
def test_plate_over_angle_is_the_closed_form(seed: int) -> None:
    """Tilted about its longer axis: the rims that the tilt parts, and waves along the sheet between them."""
    rng = np.random.default_rng(seed)
    width, height = rng.uniform(3.0, 6.0) * WAVELENGTH, rng.uniform(14.0, 20.0) * WAVELENGTH
    angle = rng.uniform(np.radians(5.0), np.radians(89.0), 40)
    result = traced(
        targets.plate(width, height),
        np.stack([np.sin(angle), 0 * angle, np.cos(angle)], axis=1),
        ("HH", "VV"),
    )
    along, across = theory.plate_along_its_sheet(width, height, WAVELENGTH, angle)
    for channel, want in (("HH", along), ("VV", across)):
        got = np.abs(result.amplitude[:, 0, result.channels.index(channel)])
        # tol: the other two rims, whose ends return a wavelength of edge where those return the height
        assert np.abs(got - np.sqrt(want)).max() < 0.07 * height / np.sqrt(np.pi)


def test_physical_optics_has_nothing_edge_on() -> None:
    plate = targets.plate(6 * WAVELENGTH, 9 * WAVELENGTH)
    look = np.array([[1.0, 0.0, 0.0]])
    alone = monostatic_rcs(plate, targets.PEC, look, FREQUENCY)
    assert np.abs(alone.amplitude).max() < 1e-6
    got = traced(plate, look)
    # tol: float32
    wanted = 10 * np.log10(theory.edge_on_rcs(9 * WAVELENGTH))
    assert got.rcs_dbsm("HH")[0] == pytest.approx(wanted, abs=1e-3)
    # a thin sheet does not disturb a wave that runs along it with its electric field across
    assert got.rcs_dbsm("VV")[0] < wanted - 60.0


def test_width_of_sheets_in_every_direction() -> None:
    """Of a plate in drawn triangles, from rims seen forwards and sidewards."""
    plate = targets.plate(0.3, 0.2, triangles=60)
    edges = edges_in(plate)
    low = edges.of(np.abs(edges.middle[:, 1] + 0.1) < 1e-9)
    turn = np.pi * ((np.arange(DIRECTIONS) + 0.5) / DIRECTIONS - 0.5)
    way = np.cos(turn)[:, None] * low.inward[:, None, 0] + np.sin(turn)[:, None] * low.along[:, None]
    to_side = (0.15 * np.sign(way[..., 0]) - low.middle[:, None, 0]) / way[..., 0]
    wanted = np.minimum(to_side, 0.2 / np.maximum(way[..., 1], 1e-9))
    # tol: halved 12 times from the plate's diagonal
    assert np.abs(low.span - wanted).max() < 2e-4
    assert np.isinf(edges_in(targets.geometry([(BOX.vertices, BOX.faces)])).span).all()


@pytest.mark.parametrize("seed", [31, 32])
def test_hv_is_vh_of_drawn_bodies(seed: int) -> None:
    rng = np.random.default_rng(seed)
    hull = trimesh.convex.convex_hull(rng.normal(size=(12, 3)) * 4 * WAVELENGTH)
    look = rng.normal(size=(30, 3))
    look /= np.linalg.norm(look, axis=1, keepdims=True)
    s = traced(targets.geometry([(hull.vertices, hull.faces)]), look).amplitude[:, 0]
    assert np.abs(s[:, 1]).max() > 1e-3 * np.abs(s[:, 0]).max()
    # tol: float32 sums
    assert np.abs(s[:, 1] - s[:, 2]).max() < 1e-5 * np.abs(s).max()


def test_what_hides_an_edge_hides_its_fringe() -> None:
    """A screen before one rim of a plate seen edge-on; and the far rims of a box."""
    plate = targets.parallelogram([-0.1, -0.1, 0], [0.2, 0, 0], [0, 0.2, 0])
    screen = targets.parallelogram([0.3, -0.5, -0.5], [0, 1, 0], [0, 0, 1])
    look = targets.from_azimuth([0.0, np.pi])
    source = PointSource(FringeCurrents(edges_in(targets.geometry([plate]))))
    both = targets.geometry([plate, screen])
    with_edges, without = (
        monostatic_rcs(both, targets.PEC, look, FREQUENCY, sources=s).amplitude[:, 0, 0]
        for s in ((source,), ())
    )
    added = np.abs(with_edges - without)
    assert added[0] < 1e-6
    assert added[1] == pytest.approx(0.2 / np.sqrt(np.pi), rel=1e-3)


# ---- images and plans


def sheet(polarisation: str, seed: int, **settings: str) -> tuple[Scene, float]:
    """A level strip across the line of sight at a drawn heading and look angle, and that angle."""
    rng = np.random.default_rng(seed)
    heading, look = rng.uniform(0.0, 360.0), rng.uniform(35.0, 50.0)
    turn = np.radians(heading)
    along, across = np.array([np.sin(turn), np.cos(turn), 0.0]), np.array([np.cos(turn), -np.sin(turn), 0.0])
    corners = np.array([a * DEPTH / 2 * across + b * STRIP / 2 * along for a, b in SIDES])
    radar = RadarDescription(
        mode="spotlight",
        slant_range=10e3,
        heading_deg=heading,
        look_angle_deg=look,
        center_frequency=9.65e9,
        bandwidth=500e6,
        azimuth_resolution=10.0,
        polarisation=polarisation,
        aim_x=0.0,
        aim_y=0.0,
        aim_z=0.0,
    )
    film = FilmDescription(
        image_grid="ground",
        image_extent_azimuth=24.0,
        image_extent_range=DEPTH + 8.0,
        pixel_spacing_azimuth=1.0,
        pixel_spacing_range=0.05,
    )
    mesh = SceneMesh(corners, [[0, 1, 2], [0, 2, 3]], "pec", "sheet")
    scene = build_scene([mesh], radar=radar, film=film)
    return (scene.replace(**settings) if settings else scene), np.radians(look)


@pytest.mark.parametrize("seed", [41, pytest.param(42, marks=pytest.mark.slow)])
def test_edges_of_a_level_sheet_in_an_image(seed: int) -> None:
    """Automatic settings, blocks and focusing included: front and rear edge differ, and HH from VV the other way."""
    scene, look = sheet("HH,VV", seed)
    image = focus(simulate(scene))
    ground = image.grid.positions() @ unit_across(scene)
    for edge, phi in ((-0.5 * DEPTH, 0.5 * np.pi + look), (0.5 * DEPTH, 0.5 * np.pi - look)):
        near = np.abs(ground - edge) < 2.0
        for channel, d in zip(("HH", "VV"), theory.wedge_coefficients(2.0, phi, phi), strict=True):
            wanted = STRIP**2 / np.pi * abs(complex(d)) ** 2
            peak = float(np.where(near, image.rcs(channel), 0.0).max())
            # tol: 0.06 dB of the azimuth response over the strip; side lobes of an edge 15 dB stronger, far off
            assert abs(10.0 * np.log10(peak / wanted)) < 0.3


def unit_across(scene: Scene) -> F64:
    look = scene.radar.aim_point - scene.radar.track.center_position
    look[2] = 0.0
    return look / np.linalg.norm(look)


def raw_and_kernels(scene: Scene) -> tuple[C64, set[str]]:
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        dr.kernel_history_clear()
        data = simulate(scene, seed=1).data
        return data, {str(kernel["hash"]) for kernel in dr.kernel_history([dr.KernelType.JIT])}


@pytest.mark.filterwarnings("ignore:.*edge_diffraction is switched off")
def test_off_is_as_if_there_were_no_edges() -> None:
    """A scene that leaves edges out by itself, and one that switches them off: no kernel more, the same bits."""
    plate = load_scene("plate")
    assert not plan_effects(plate).flags.on("edge_diffraction")
    left_out, switched_off = (raw_and_kernels(s) for s in (plate, plate.replace(edge_diffraction="off")))
    assert np.array_equal(left_out[0], switched_off[0]) and left_out[1] == switched_off[1]
    on, more = raw_and_kernels(plate.replace(edge_diffraction="on"))
    assert more > left_out[1] and not np.array_equal(on, left_out[0])
    # an edge's share of a plate that faces the radar
    assert np.linalg.norm(on - left_out[0]) < 0.01 * np.linalg.norm(on)


def test_the_plan_says_what_edges_add() -> None:
    """On where they count, also where waves go from metal to metal; off below the tolerance and without metal."""
    found = [name for name in SHIPPED if plan_scene(load_scene(name)).on("edge_diffraction")]
    # without a pilot nobody knows what a corner's mirrors return beside its edges
    assert found == ["plate_edges", "dihedral", "trihedral", "trihedral_square"]
    plan = plan_effects(load_scene("plate", parameters={"tilt_deg": "10"}))
    assert plan.on("edge_diffraction")
    assert plan_effects(load_scene("trihedral", parameters={"sar_antenna.center_frequency": "2e9"})).on(
        "edge_diffraction"
    )


def plate_among_bars(seed: int, **settings: str) -> Scene:
    """A plate that faces the radar among hundreds of bars, each far below it."""
    rng = np.random.default_rng(seed)
    turned = trimesh.transformations.rotation_matrix(-np.pi / 4, [0, 1, 0])
    face = targets.parallelogram([-1, -1, 0], [2, 0, 0], [0, 2, 0])
    meshes = [SceneMesh(*face, "pec", "plate", to_world=turned)]
    bar = trimesh.creation.box(extents=(0.3, 2.0, 0.3))
    lean = trimesh.transformations.rotation_matrix(np.radians(rng.uniform(15.0, 25.0)), [0, 1, 0])
    for number, place in enumerate(np.ndindex(20, 20)):
        x, y = 3.0 * np.array(place) - 28.5 + rng.uniform(-0.3, 0.3, 2)
        if max(abs(x), abs(y)) > 5.0:
            to = trimesh.transformations.translation_matrix([x, y, 0.0]) @ lean
            meshes.append(SceneMesh(bar.vertices, bar.faces, "pec", f"bar{number}", to_world=to))
    radar = RadarDescription(
        mode="spotlight",
        look_angle_deg=45.0,
        slant_range=5000.0,
        center_frequency=9.65e9,
        bandwidth=150e6,
        azimuth_resolution=1.0,
        polarisation="HH,VV",
    )
    film = FilmDescription(image_extent_azimuth=64.0, image_extent_range=64.0)
    scene = build_scene(meshes, radar=radar, film=film)
    return scene.replace(**settings) if settings else scene


@pytest.mark.slow
@pytest.mark.parametrize("seed", [61, 62])
@pytest.mark.filterwarnings("ignore:.*edge_diffraction is switched off")
def test_many_weak_edges_count_by_their_energy(seed: int) -> None:
    """Together they are above the tolerance, and no more than the plan states."""
    decision = plan_scene(plate_among_bars(seed)).decision("edge_diffraction")
    assert decision is not None and decision.on
    there, without = (
        np.asarray(focus(simulate(plate_among_bars(seed, edge_diffraction=x), seed=1)).data)
        for x in ("on", "off")
    )
    change = np.square(np.abs(there - without)).sum(axis=(-2, -1)).max()
    actual = 10.0 * np.log10(change / np.square(np.abs(without)).sum(axis=(-2, -1)).max())
    print(f"{decision.why}; the image changes by {actual:.1f} dB")
    assert -40.0 < actual < decision.error_db


@pytest.mark.parametrize("seed", [51])
def test_sweeps_have_edges_by_themselves(seed: int) -> None:
    """A turntable's plate from drawn aspects, by the plan's own decision; off it is physical optics."""
    rng = np.random.default_rng(seed)
    elevation = rng.uniform(np.radians(3.0), np.radians(60.0), 15)
    size = (5.0, 60.0)
    upright = targets.parallelogram([0, 0, 0], [size[0] * WAVELENGTH, 0, 0], [0, size[1] * WAVELENGTH, 0])
    radar = RadarDescription(center_frequency=FREQUENCY)
    scene = build_scene([SceneMesh(*upright, "pec", "plate")], radar=radar)
    result = rcs_sweep(scene, Aspects(np.zeros(15), elevation), channels=("HH", "VV"))
    closed = theory.plate_along_its_sheet(
        size[0] * WAVELENGTH, size[1] * WAVELENGTH, WAVELENGTH, 0.5 * np.pi - elevation
    )
    for channel, want in zip(("HH", "VV"), closed, strict=True):
        got = 10.0 ** (result.dbsm(channel) / 20.0)
        # tol: the rims across, a wavelength of 60; Fresnel's integral to 0.004
        assert np.abs(got - np.sqrt(want)).max() < 0.04 * np.sqrt(theory.edge_on_rcs(size[1] * WAVELENGTH))


def test_edges_of_good_conductors_are_those_of_metal() -> None:
    """Steel has them as a perfect conductor does, wet ground has none."""
    plate = targets.plate(1.0, 2.0)
    perfect, steel, wet = (
        edges_of(plate, (material,), WAVELENGTH)
        for material in (
            Material("pec", pec=True),
            Material("steel", permittivity=1.0 - 1.8e7j),
            Material("wet_ground", permittivity=25.0 - 8.0j),
        )
    )
    assert perfect.n == steel.n > 0 and wet.n == 0
    assert np.array_equal(perfect.middle, steel.middle)


@pytest.mark.parametrize("thickness", [0.008, 0.03, 0.045])
def test_thin_plates_are_the_closed_form(thickness: float) -> None:
    """A long upright plate from drawn aspects: physical optics of its faces, rims and what its thickness adds."""
    rng = np.random.default_rng(int(1e3 * thickness))
    width, height = rng.uniform(2.0, 4.0), 40.0
    size = np.array([thickness, width, height]) * WAVELENGTH
    box = trimesh.creation.box(extents=size)
    plate = targets.geometry([(np.asarray(box.vertices), np.asarray(box.faces, dtype=np.int32))])
    azimuth = np.append(rng.uniform(np.radians(1.0), np.radians(89.0), 20), 0.5 * np.pi)
    edges = edges_of(plate, targets.PEC, WAVELENGTH)
    result = monostatic_rcs(
        plate,
        targets.PEC,
        targets.from_azimuth(azimuth, np.zeros(azimuth.size)),
        FREQUENCY,
        max_depth=1,
        ray_spacing=WAVELENGTH / 25.0,
        sources=(PointSource(FringeCurrents(edges)),),
    )
    # upright rims: VV has the field along them
    closed = theory.thin_plate(size[1], size[2], size[0], WAVELENGTH, azimuth)
    edge_on = np.sqrt(theory.edge_on_rcs(size[2]))
    for channel, want in zip(("VV", "HH"), closed, strict=True):
        got = 10.0 ** (result.rcs_dbsm(channel) / 20.0)
        # tol: the rims across, a thirteenth as long; a quarter of the electric part is the wedges' at 0.045
        assert np.abs(got - np.sqrt(want)).max() < 0.03 * edge_on


@pytest.mark.parametrize("seed", [71, 72])
def test_nothing_jumps_where_a_wave_grazes_two_opposite_faces(seed: int) -> None:
    """A box turned through the direction of two of its faces: the far edge of one passes over into the other's."""
    rng = np.random.default_rng(seed)
    box = trimesh.creation.box(extents=rng.uniform(2.0, 4.0, 3) * WAVELENGTH)
    body = targets.geometry([(np.asarray(box.vertices), np.asarray(box.faces, dtype=np.int32))])
    azimuth = np.radians(np.linspace(-0.1, 0.1, 81))
    looks = targets.from_azimuth(azimuth, np.full(azimuth.size, np.radians(rng.uniform(10.0, 40.0))))
    flags = {"max_depth": 1, "channels": ("HH", "VV")}
    source = PointSource(FringeCurrents(edges_in(body)))
    both, optics = (
        monostatic_rcs(body, targets.PEC, looks, FREQUENCY, sources=sources, **flags).amplitude[:, 0]
        for sources in ((source,), ())
    )
    edges = both - optics
    step = np.abs(np.diff(edges, axis=0)).max(axis=0) / np.abs(edges).max(axis=0)
    # tol: 46 steps of the passage, and an edge is at most twice the sum
    assert step.max() < 0.06
    assert np.abs(edges[0] - edges[-1]).max() < 0.02 * np.abs(edges).max()


def test_rough_metal_loses_its_edges_waves_as_its_faces() -> None:
    """Rms height of 0.15 wavelengths, 20 to 50 degrees off the normal: both by the coherent loss of a face."""
    shape = targets.geometry([targets.parallelogram([0, -3, -2.0], [0, 6, 0], [0, 0, 4.0])])
    rough = tuple(replace(material, rms_height=0.15) for material in targets.PEC)
    looks = targets.from_azimuth(np.radians([20.0, 35.0, 50.0]))
    levels = []
    for materials in (targets.PEC, rough):
        edges = PointSource(FringeCurrents(edges_of(shape, materials, 1.0)))
        found = monostatic_rcs(shape, materials, looks, SPEED_OF_LIGHT, sources=(edges,))
        levels.append(np.stack([found.rcs_dbsm(channel) for channel in ("HH", "VV")]))
    loss = -2.0 * np.square(2.0 * np.pi * 0.15 * looks[:, 0]) * 20.0 / np.log(10.0)
    assert loss[1] == pytest.approx(-10.4, abs=0.1)
    # tol: single precision of amplitudes
    assert levels[1] - levels[0] == pytest.approx(np.stack([loss, loss]), abs=1e-3)
