"""Slabs and panes beside what the validation cases hold: limits, drawn walls, what stands aside, boxes of two faces."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from sarmitsuba import Motion, PointTarget, RadarDescription, Scene, SceneMesh, build_scene, simulate
from sarmitsuba.core.arrays import C64, C128, F64
from sarmitsuba.core.errors import SceneError
from sarmitsuba.effects.plan import plan_effects
from sarmitsuba.loading.load import load_scene
from sarmitsuba.machine.backend import dr, ensure_backend, mi
from sarmitsuba.radar.film import FilmDescription
from sarmitsuba.scene.materials.material import Material
from sarmitsuba.scene.materials.slab import slab_coefficients
from sarmitsuba.signal.metrics import point_target_in
from sarmitsuba.simulation.execution import tracing
from sarmitsuba.simulation.execution.rcs import monostatic_rcs
from sarmitsuba.tracing.kernel import field
from sarmitsuba.tracing.kernel.leg import Leg
from sarmitsuba.tracing.kernel.source import PointSource, Scatterers, Source
from sarmitsuba.tracing.kernel.state import Kernel
from sarmitsuba.tracing.scatterers.slabs.slab_coefficients import slab
from sarmitsuba.tracing.scatterers.sources import Site
from sarmitsuba.truth import theory
from sarmitsuba.truth.validation import targets
from sarmitsuba.truth.validation.band_sampling import X_BAND, X_WAVELENGTH
from sarmitsuba.truth.validation.cases.rooms import room
from sarmitsuba.truth.validation.cases.slabs import GLASS, dyad, kernel_slab
from tests.support.unweighted import render

COSINE = np.cos(np.radians(np.concatenate([np.linspace(0.0, 89.0, 179), [89.5, 89.9, 89.99]])))
PANE = Material("pane", permittivity=GLASS, thickness=0.006)
FACES = [[0, 1, 2], [0, 2, 3]]


def test_the_closed_form_knows_half_and_quarter_waves() -> None:
    """A slab half a wave thick is not there; one of a quarter wave reflects (1 - eps) / (1 + eps)."""
    for eps in (2.25, 4.0, 6.31):
        inside = X_WAVELENGTH / np.sqrt(eps)
        half, quarter = (theory.slab(1.0, eps, t, X_WAVELENGTH) for t in (0.5 * inside, 0.25 * inside))
        assert abs(half.r_te) < 1e-12 and abs(half.t_te + 1.0) < 1e-12
        assert quarter.r_te == pytest.approx((1.0 - eps) / (1.0 + eps), abs=1e-12)
        assert quarter.r_tm == pytest.approx(-quarter.r_te, abs=1e-12)


@pytest.mark.parametrize("seed", range(3))
def test_coefficients_of_drawn_slabs(seed: int) -> None:
    """Lines' matrices against sums of reflections: from a film to a wall of many wavelengths, coated or not."""
    rng = np.random.default_rng([seed, 9])
    for _ in range(50):
        eps = complex(1.0 + 10.0 ** rng.uniform(-2.0, 3.0), -(10.0 ** rng.uniform(-6.0, 4.0)))
        thickness, wavelength = 10.0 ** rng.uniform(-5.0, 0.0), 10.0 ** rng.uniform(-2.0, 0.0)
        resistance = rng.choice([0.0, 10.0 ** rng.uniform(-1.0, 3.0)])
        cosine = rng.uniform(0.01, 1.0, 20)
        material = Material(
            "drawn", permittivity=eps, thickness=thickness, sheet_resistance=float(resistance)
        )
        got = slab_coefficients(material, wavelength, cosine)
        wanted = theory.slab(cosine, eps, thickness, wavelength, resistance)
        behind = theory.slab_insertion(cosine, eps, thickness, wavelength, resistance)
        for a, b in zip(
            (got.r_te, got.r_tm, got.t_te, got.t_tm), (wanted.r_te, wanted.r_tm, *behind), strict=True
        ):
            assert np.abs(a - b).max() < 1e-10  # tol: rounding of phases up to 1e4 rad


def test_the_closed_form_of_a_sheet_alone() -> None:
    """A slab of vacuum with a sheet: r = -y / (2 + y) square on; a matched one, 377 / 2 ohm, takes half."""
    wave = theory.slab(1.0, 1.0, 0.01, X_WAVELENGTH, 376.730313 / 2.0, sheet_first=True)
    assert wave.r_te == pytest.approx(-0.5, abs=1e-6) and abs(wave.t_te) == pytest.approx(0.5, abs=1e-6)


@pytest.mark.parametrize("seed", range(6))
def test_energy_of_drawn_walls(seed: int) -> None:
    """Lossless: all of it comes back or goes through, at every angle. With loss or a coat: never more."""
    rng = np.random.default_rng([seed, 3])
    eps, thickness = float(rng.uniform(1.05, 40.0)), float(10.0 ** rng.uniform(-6.0, 0.0))
    lossless = kernel_slab(COSINE, complex(eps), thickness)
    loss = complex(eps, -float(10.0 ** rng.uniform(-3.0, 2.0)))
    lossy = kernel_slab(COSINE, loss, thickness)
    coated = kernel_slab(COSINE, complex(eps), thickness, float(10.0 ** rng.uniform(0.0, 3.0)))
    for p in ("TE", "TM"):
        total, less, coat = (
            np.abs(x[f"R {p}"]) ** 2 + np.abs(x[f"T {p}"]) ** 2 for x in (lossless, lossy, coated)
        )
        assert np.abs(total - 1.0).max() < 1e-4  # asked for; float32 leaves 1e-6
        assert (less < 1.0 + 1e-5).all() and (coat < 1.0 + 1e-5).all()  # tol: float32


@pytest.mark.parametrize("seed", range(3))
def test_delay_and_shift_of_drawn_walls(seed: int) -> None:
    """How far a pulse falls behind in a wall and how far it is moved sideways, against differences of phases."""
    ensure_backend()
    rng = np.random.default_rng([seed, 4])
    eps = complex(rng.uniform(1.5, 10.0), -(10.0 ** rng.uniform(-3.0, -0.5)))
    thickness, resistance = float(10.0 ** rng.uniform(-3.0, -0.7)), float(10.0 ** rng.uniform(1.5, 4.0))
    cosine = np.cos(np.radians(np.linspace(1.0, 85.0, 85))).astype(np.float32)
    wave = slab(
        mi.Float(cosine),
        mi.Complex2f(eps - 1.0),
        mi.Float(2.0 * np.pi / X_WAVELENGTH * thickness),
        mi.Float(376.730313 / resistance),
        mi.Bool(False),
    )
    exact = cosine.astype(np.float64)
    wall = (exact, eps, thickness, X_WAVELENGTH, resistance)
    te, tm = (np.abs(t) ** 2 for t in theory.slab_insertion(*wall))
    sine = np.sqrt(1.0 - exact**2)
    for got, (a, b) in (
        (np.asarray(wave.extra, np.float64), theory.slab_delay(*wall)),
        (np.asarray(wave.aside, np.float64) * sine, theory.slab_shift(*wall)),
    ):
        want = (te * a + tm * b) / (te + tm)
        assert (
            np.abs(got * X_WAVELENGTH / (2.0 * np.pi) - want).max() < 5e-5
        )  # tol: float32 phases of up to 100 rad


@pytest.mark.slow
def test_blocks_of_pulses_see_what_every_pulse_sees_through_a_wall() -> None:
    """The phase of a thick wall turns with the line of sight: as its way sideways says, from the key pulse on."""
    for eps, thickness in ((3.91 - 0.06j, 0.12), (2.73 - 0.02j, 0.3)):
        scene = room(
            135.0, 54.0, np.radians(30.0), 2.0, Material("wall", permittivity=eps, thickness=thickness)
        )
        each = simulate(scene.replace(method="raw"), seed=1).data
        blocks = simulate(scene, seed=1).data
        assert np.linalg.norm(blocks - each) < 10 ** (-35 / 20) * np.linalg.norm(each)
        # tol: -38 dB, and -23 dB without the way sideways


def test_limits_in_the_kernel() -> None:
    """No thickness: nothing there. Thick and lossy: the half space. At Brewster's angle: all TM goes through."""
    for eps in (4.0 + 0.0j, GLASS):
        none = kernel_slab(COSINE[:170], eps, 1e-9)
        for p in ("TE", "TM"):
            assert np.abs(none[f"R {p}"]).max() < 1e-4  # tol: k d chi / 2 cos at 84 degrees, 1e-5
            assert np.abs(none[f"T {p}"] - 1.0).max() < 1e-4
    thick = kernel_slab(COSINE, 5.24 - 0.507j, 2.0)
    te, tm = theory.fresnel(COSINE, 5.24 - 0.507j)
    assert np.abs(thick["R TE"] - te).max() < 1e-5  # tol: float32
    assert np.abs(thick["R TM"] - tm).max() < 1e-5
    assert max(np.abs(thick["T TE"]).max(), np.abs(thick["T TM"]).max()) < 1e-15
    for eps in (2.0, 6.31, 30.0):
        brewster = np.array([np.cos(np.arctan(np.sqrt(eps)))])
        for thickness in (0.001, 0.0071, 0.05):
            wave = kernel_slab(brewster, complex(eps), thickness)
            assert abs(abs(wave["T TM"][0]) - 1.0) < 1e-5 and abs(wave["R TM"][0]) < 1e-5


def upright(x: float, width: float = 4.0, turn: float = 0.35) -> targets.Mesh:
    """A pane about (x, 0, 0), turned off the line of sight along x."""
    across = np.array([np.sin(turn), np.cos(turn), 0.0])
    up = np.array([-np.sin(0.2) * np.cos(turn), np.sin(0.2) * np.sin(turn), np.cos(0.2)])
    middle = np.array([x, 0.0, 0.0])
    return targets.parallelogram(middle - 0.5 * width * (across + up), width * across, width * up)


PLATE = targets.parallelogram([0, -0.25, -0.25], [0, 0.5, 0], [0, 0, 0.5])


def amplitude(
    meshes: Sequence[targets.Mesh], materials: tuple[Material, ...], numbers: list[int], depth: int = 1
) -> C128:
    result = monostatic_rcs(
        targets.geometry(meshes, numbers),
        materials,
        [[1.0, 0.0, 0.0]],
        X_BAND,
        max_depth=depth,
        ray_spacing=0.02,
    )
    return np.asarray(result.amplitude[0, 0])


def test_a_box_of_two_faces_is_one_slab() -> None:
    """A pane modelled as a box, its faces 6 mm apart, lets through what a sheet of facets does, from both sides."""
    sheet = upright(2.0)
    normal = np.cross(sheet[0][1] - sheet[0][0], sheet[0][2] - sheet[0][0])
    normal /= np.linalg.norm(normal)
    materials = (*targets.PEC, PANE)
    one = amplitude([PLATE, sheet], materials, [0, 1])
    for side in (1.0, -1.0):
        rear = (sheet[0] + side * 0.006 * normal, sheet[1])
        box = amplitude([PLATE, sheet, rear], materials, [0, 1, 1])
        assert np.abs(np.abs(box / one) - 1.0).max() < 0.005  # tol: side lobes of the pane
    twice = amplitude([PLATE, sheet, (sheet[0] + 0.1 * normal, sheet[1])], materials, [0, 1, 1])
    assert np.abs(np.abs(twice / one) - np.abs(one / amplitude([PLATE], materials, [0]))).max() < 0.01


def test_two_crossed_panes_turn_the_polarisation_in_their_order() -> None:
    """Out through the near pane first, home through it last: q . A B B A e."""
    near, far = upright(4.0, turn=0.9), upright(2.0, turn=-0.5)
    materials = (*targets.PEC, PANE)
    bare = amplitude([PLATE], materials, [0])[0]
    got = amplitude([PLATE, near, far], materials, [0, 1, 1]) / bare
    a, b = (
        dyad(np.cross(m[0][1] - m[0][0], m[0][2] - m[0][0]), np.array([-1.0, 0.0, 0.0]), (GLASS, 0.006, 0.0))
        for m in (near, far)
    )
    both = a @ b @ b @ a
    want = np.array([both[1, 1], both[2, 2]])
    assert np.abs(np.abs(got) - np.abs(want)).max() < 0.005  # tol: side lobes of the panes


def test_a_path_goes_through_six_panes() -> None:
    """What stands behind a seventh is not seen; see `docs/materials.md`."""
    thin = replace(PANE, permittivity=1.5 + 0.0j)
    materials = (*targets.PEC, thin)
    levels = [
        amplitude([PLATE, *(upright(1.0 + 0.5 * i) for i in range(n))], materials, [0] + [1] * n)[0]
        for n in (0, 6, 7)
    ]
    assert abs(levels[1]) > 0.5 * abs(levels[0]) and abs(levels[2]) < 0.02 * abs(levels[0])


def test_a_coated_pane_reflects_as_its_sheet_formula_from_both_sides() -> None:
    """Level of a coated plate square on, within 0.1 dB, the coat on the far face and on the near one."""
    square = targets.parallelogram([0, -0.25, -0.25], [0, 0.5, 0], [0, 0, 0.5])
    turned = (square[0], square[1][:, ::-1].copy())
    coated = replace(PANE, sheet_resistance=4.0)
    metal = amplitude([square], targets.PEC, [0])[0]
    for mesh, first in ((square, False), (turned, True)):
        got = abs(amplitude([mesh], (coated,), [0])[0] / metal)
        want = abs(theory.slab(1.0, GLASS, 0.006, X_WAVELENGTH, 4.0, sheet_first=first).r_te)
        assert abs(20.0 * np.log10(got / want)) < 0.1  # asked for
    assert abs(20.0 * np.log10(abs(theory.slab(1.0, 1.0, 1e-6, X_WAVELENGTH, 4.0).r_te))) < 0.2


RADAR = RadarDescription(
    center_frequency=X_BAND,
    slant_range=2e3,
    look_angle_deg=50.0,
    bandwidth=150e6,
    azimuth_resolution=2.0,
    pattern="rectangular",
    antenna_length=1.0,
    elevation_beamwidth_deg=20.0,
    aim_x=0.0,
    aim_y=0.0,
    aim_z=0.0,
)
FILM = FilmDescription(image_extent_azimuth=14.0, image_extent_range=14.0)
GROUND = np.array([[-12.0, -12.0, 0.0], [12.0, -12.0, 0.0], [12.0, 12.0, 0.0], [-12.0, 12.0, 0.0]])
ROUGH = {"material": "concrete", "rms_height": 0.005, "diffuse_law": "lambert", "diffuse_level_db": -15.0}
GLAZED = {"material": "glass", "smooth": True, "thickness": 0.006}


def scene_of(*shapes: SceneMesh, ground: bool = True) -> Scene:
    meshes = [SceneMesh(GROUND, FACES, ROUGH, "ground")] if ground else []
    return build_scene([*meshes, *shapes], radar=RADAR, film=FILM)


def wall(x: float, y: float, width: float, low: float, high: float) -> F64:
    return np.array([[x, y, low], [x, y + width, low], [x, y + width, high], [x, y, high]])


@pytest.mark.filterwarnings("ignore::sarmitsuba.core.errors.SarmitsubaWarning")  # switched off on purpose
def test_a_pane_aside_changes_nothing_else() -> None:
    """The clutter of a ground with a small pane high over a corner of it is that of the ground alone."""
    aside = SceneMesh(wall(4.0, -5.0, 0.3, 1.0, 1.3), FACES, GLAZED, "pane")
    scene = scene_of(aside).replace(ray_spacing=0.2)
    assert {d.name: d.on for d in plan_effects(scene).decisions}["transmission"]
    with_it = simulate(scene, seed=1).data
    blocked = simulate(scene.replace(transmission="off"), seed=1).data
    assert np.linalg.norm(with_it - blocked) < 0.1 * np.linalg.norm(blocked)


def kernels(scene: Scene) -> tuple[C64, set[str]]:
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        dr.kernel_history_clear()
        data = simulate(scene, seed=1).data
        names = {str(kernel["hash"]) for kernel in dr.kernel_history([dr.KernelType.JIT])}
    return data, names


@pytest.mark.filterwarnings("ignore::sarmitsuba.core.errors.SarmitsubaWarning")  # switched off on purpose
def test_off_is_off() -> None:
    """A thickness that the plan or the user leaves out makes the kernel and the bits of a half space."""
    ensure_backend()
    place = wall(2.0, -3.0, 6.0, 0.0, 4.0)
    plain = scene_of(SceneMesh(place, FACES, {"material": "glass", "smooth": True}, "pane"))
    off = scene_of(SceneMesh(place, FACES, GLAZED, "pane")).replace(slabs="off", transmission="off")
    data, kernel = kernels(plain)
    other, same = kernels(off)
    assert np.array_equal(data, other) and kernel == same


def test_the_plan_says_why() -> None:
    """On only where something lies behind; off with a reason and the error it would make."""

    def decided(*shapes: SceneMesh, ground: bool = True) -> dict[str, tuple[bool, str]]:
        plan = plan_effects(scene_of(*shapes, ground=ground), warn=False)
        return {d.name: (d.on, d.why) for d in plan.decisions}

    pane = wall(2.0, -3.0, 6.0, 0.0, 4.0)
    behind = decided(SceneMesh(pane, FACES, GLAZED, "pane"))
    assert behind["slabs"][0] and behind["transmission"][0]
    alone = decided(SceneMesh(pane, FACES, GLAZED, "pane"), ground=False)
    assert alone["slabs"][0] and not alone["transmission"][0]
    assert "nothing lies behind" in alone["transmission"][1]
    thick = decided(
        SceneMesh(pane, FACES, {"material": "concrete", "smooth": True, "thickness": 0.4}, "wall")
    )
    assert not thick["slabs"][0] and not thick["transmission"][0]
    assert "half space" in thick["slabs"][1] and "two-way transmission at most" in thick["transmission"][1]
    none = decided(SceneMesh(pane, FACES, {"material": "glass", "smooth": True}, "wall"))
    assert none["slabs"] == (False, "no material has a thickness")


class Isotropic(Scatterers):
    """Returns what it gets: sqrt(rcs) q . e."""

    def __init__(self, points: F64) -> None:
        self.n, self.points = len(points), points

    def point(self, index: mi.UInt32) -> mi.Vector3d:
        return dr.gather(mi.Vector3d, mi.Float64(np.ascontiguousarray(self.points.reshape(-1))), index)

    def amplitude(
        self,
        kernel: Kernel,
        index: mi.UInt32,
        incident: Leg,
        scattered: Leg,
        e: field.ComplexVector,
        q: field.ComplexVector,
    ) -> mi.Complex2f:
        return field.dot(e, q[0]) + mi.Complex2f(0.0, 1.0) * field.dot(e, q[1])


def test_scatterers_that_no_ray_finds_are_seen_through_panes(monkeypatch: pytest.MonkeyPatch) -> None:
    """Level T^2 of the pane's dyad, both ways, of a scatterer with a closed form behind it."""
    ensure_backend()
    pane = SceneMesh(wall(0.0, -8.0, 16.0, 0.0, 9.0), FACES, GLAZED, "pane")
    place = np.array([[2.0, 0.5, 1.0]])

    def echo(scene: Scene) -> C64:
        found = []
        for sources in ((), (PointSource(Isotropic(place)),)):

            def given(site: Site, s: tuple[Source, ...] = sources) -> tuple[Source, ...]:
                return s

            with monkeypatch.context() as patch:
                patch.setattr(tracing, "sources_of", given)
                found.append(simulate(scene, seed=1).data)
        return np.asarray(found[1] - found[0])

    free = echo(scene_of().replace(ray_spacing=0.3))
    scene = scene_of(pane).replace(ray_spacing=0.3)
    behind = echo(scene)
    sight = scene.radar.track.center_position - place[0]
    sight /= np.linalg.norm(sight)
    through = dyad(np.array([1.0, 0.0, 0.0]), -sight, (scene.materials[1].permittivity, 0.006, 0.0))
    h = np.cross(-sight, [0.0, 0.0, 1.0])
    h /= np.linalg.norm(h)
    v = np.cross(h, -sight)
    want = abs(v @ through @ through @ v)
    assert scene.radar.channels == ("VV",)
    assert np.linalg.norm(behind) / np.linalg.norm(free) == pytest.approx(want, rel=0.005)
    # tol: gridding, and 15 mm of range that the receive window's edges see


@pytest.mark.parametrize(
    ("words", "parts"),
    [
        ({"material": "pec", "thickness": 0.01}, ("thickness = 0.01 m", "which is opaque")),
        ({"material": "glass", "sheet_resistance": 5.0}, ("sheet_resistance = 5 ohm", "give its thickness")),
        ({"material": "glass", "thickness": -0.1}, ("thickness", "-0.1")),
    ],
)
def test_words_that_cannot_be_are_refused(words: dict[str, object], parts: tuple[str, ...]) -> None:
    with pytest.raises(SceneError) as error:
        scene_of(SceneMesh(wall(2.0, -3.0, 6.0, 0.0, 4.0), FACES, words, "pane"))
    assert "\n" not in str(error.value) and all(part in str(error.value) for part in parts)


def test_panes_by_name() -> None:
    """A named pane has its thickness and coat; a file's own words win."""
    scene = load_scene("glass_house")
    plain, coated = (next(m for m in scene.materials if m.name == n) for n in ("plain_pane", "coated_pane"))
    assert (plain.thickness, plain.sheet_resistance) == (0.006, 0.0)
    assert (coated.thickness, coated.sheet_resistance) == (0.006, 4.0)
    named = scene_of(SceneMesh(wall(2.0, -3.0, 6.0, 0.0, 4.0), FACES, "low_e_glass", "pane")).materials[1]
    assert (named.thickness, named.sheet_resistance) == (0.004, 4.0)


@pytest.mark.filterwarnings(
    "ignore::sarmitsuba.core.errors.SarmitsubaWarning"
)  # nothing but the point, on purpose
@pytest.mark.parametrize("method", ["hybrid", "image"])
def test_an_ideal_point_shows_through_a_pane(method: str) -> None:
    """Level and delay of both ways through a wall of brick, by raw data and by an image of one look."""
    brick = {"permittivity_real": 3.91, "permittivity_imag": 0.06, "thickness": 0.12}
    point = PointTarget("point", np.array([2.0, 0.5, 1.0]), 100.0)
    radar = replace(RADAR, bandwidth=300e6, polarisation="HH,VV")
    images, scenes = [], []
    for shapes in ([], [SceneMesh(wall(0.0, -8.0, 16.0, 0.0, 9.0), FACES, brick, "wall")]):
        aside = SceneMesh(0.01 * GROUND + [5.0, 5.0, 0.0], FACES, "pec", "aside")
        scene = build_scene([aside, *shapes], [point], radar=radar, film=FILM).replace(
            method=method,
            coherent="off",
            wideband="off",  # the level at the carrier
        )
        scenes.append(scene)
        images.append(render(scene, seed=1))
    bare, behind = ([point_target_in(image, c) for c in ("HH", "VV")] for image in images)
    sight = scenes[1].radar.track.center_position - point.position
    sight /= np.linalg.norm(sight)
    through = dyad(np.array([1.0, 0.0, 0.0]), -sight, (3.91 - 0.06j, 0.12, 0.0))
    h = np.cross(-sight, [0.0, 0.0, 1.0])
    h /= np.linalg.norm(h)
    for i, q in enumerate((h, np.cross(h, -sight))):
        want = 20.0 * np.log10(abs(q @ through @ through @ q))
        assert 10.0 * np.log10(behind[i].rcs / bare[i].rcs) == pytest.approx(
            want, abs=0.05
        )  # tol: interpolated peaks
    farther = behind[0].range_position - bare[0].range_position
    te, tm = (float(x) for x in theory.slab_delay(abs(sight[0]), 3.91 - 0.06j, 0.12, X_WAVELENGTH))
    assert min(te, tm) - 2e-3 < farther < max(te, tm) + 2e-3


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:.*is switched off")
def test_what_hardly_moves_and_two_antennas_in_one_place_see_the_sameroom() -> None:
    """Posed pulse by pulse, and received by an antenna apart: the room of every other kernel."""
    shapes = [
        SceneMesh(wall(0.0, -4.0, 8.0, 0.0, 4.0), FACES, GLAZED, "pane"),
        SceneMesh(wall(6.0, -4.0, 8.0, 0.0, 4.0), FACES, "pec", "back"),
    ]
    meshes = [SceneMesh(GROUND, FACES, ROUGH, "ground"), *shapes]
    radar = replace(RADAR, heading_deg=-15.0)
    # edges of metal that moves are left out
    quiet = {"edge_diffraction": "off"}
    rest = simulate(build_scene(meshes, radar=radar, film=FILM).replace(method="raw", **quiet), seed=1).data
    creeping = replace(meshes[2], motion=Motion((1e-9, 0.0, 0.0)))
    scene = build_scene([*meshes[:2], creeping], radar=radar, film=FILM)
    moving = simulate(scene.replace(**quiet), seed=1).data
    assert np.linalg.norm(moving - rest) < 1e-3 * np.linalg.norm(
        rest
    )  # tol: gridding of one pulse or another
    apart = replace(radar, receiver_offset_along=1e-4)
    # corners apart: two antennas have no reversed chain to share their return with
    one, both = (
        simulate(build_scene(meshes, radar=r, film=FILM).replace(method="raw", coherent="off"), seed=1).data
        for r in (radar, apart)
    )
    # tol: the way home of first hits is retraced
    assert np.linalg.norm(both - one) < 1e-2 * np.linalg.norm(one)
