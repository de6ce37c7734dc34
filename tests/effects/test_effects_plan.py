"""Plans of scenes built to deceive: each static rule and the pilot must come to the right bounce depth."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from sarmitsuba.core.arrays import F64, I32
from sarmitsuba.effects.context import SceneContext
from sarmitsuba.effects.plan import plan_effects
from sarmitsuba.effects.shape import ShapeAnalysis
from sarmitsuba.loading.library import resolve
from sarmitsuba.loading.load import load_scene
from sarmitsuba.scene.geometry import Geometry
from sarmitsuba.scene.materials.material import Material
from sarmitsuba.scene.mesh.tessellate import cube, sphere
from sarmitsuba.scene.scene import Scene
from sarmitsuba.simulation.planning.pilot import CHANNELS, patch_echoes, place_patches, plan_scene, run_pilot
from sarmitsuba.simulation.planning.sampling.density_plan import SamplingPlan
from sarmitsuba.tracing.kernel.scene_tables import build_trace_scene

PEC = Material("pec", pec=True)
SOIL = Material(
    "soil", permittivity=5.0 - 0.5j, rms_height=0.02, diffuse_law="constant", diffuse_level_db=-15.0
)

Mesh = tuple[F64, I32, int]  # vertices, faces, material number


def quad(a: list[float], b: list[float], c: list[float], d: list[float], material: int) -> Mesh:
    return np.array([a, b, c, d], dtype=float), np.array([[0, 1, 2], [0, 2, 3]], dtype=np.int32), material


def plain(half: float) -> Mesh:
    return quad([-half, -half, 0], [half, -half, 0], [half, half, 0], [-half, half, 0], 1)


def box(low: list[float], high: list[float], material: int = 0) -> Mesh:
    corners = np.array(
        [[x, y, z] for x in (low[0], high[0]) for y in (low[1], high[1]) for z in (low[2], high[2])]
    )
    sides = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    faces = [f for a, b, c, d in sides for f in ((a, b, c), (a, c, d))]
    return corners, np.array(faces, dtype=np.int32), material


def geometry(*meshes: Mesh) -> Geometry:
    vertices, faces, material, group, start = [], [], [], [], 0
    for i, (v, f, m) in enumerate(meshes):
        vertices.append(v)
        faces.append(f + start)
        material.append(np.full(len(f), m, dtype=np.int32))
        group.append(np.full(len(f), i, dtype=np.int32))
        start += len(v)
    offset = np.concatenate([[0], np.cumsum([len(m[1]) for m in meshes])])
    return Geometry(
        np.concatenate(vertices),
        np.concatenate(faces).astype(np.int32),
        np.concatenate(material),
        np.concatenate(group),
        tuple(f"m{i}" for i in range(len(meshes))),
        offset.astype(np.int64),
    )


@pytest.fixture(scope="module")
def base() -> Scene:
    """The radar of the flat ground: 10 km, look angle 35 degrees, flying along y and looking along x."""
    return load_scene(resolve("flat_ground"))


def scene(base: Scene, *meshes: Mesh, extent: float = 100.0) -> Scene:
    image = replace(base.image, extent_azimuth=extent, extent_range=extent)
    return replace(base, geometry=geometry(*meshes), materials=(PEC, SOIL), image=image)


def towards_radar(base: Scene, at: F64) -> F64:
    d = base.radar.track.center_position - at
    return np.asarray(d / np.linalg.norm(d))


def trihedral(base: Scene, at: list[float], side: float) -> Mesh:
    """Corner reflector whose opening looks at the radar."""
    origin = np.array(at)
    axis = towards_radar(base, origin)
    spare = np.cross(axis, [0.0, 1.0, 0.0])
    u = spare / np.linalg.norm(spare)
    w = np.cross(axis, u)
    arms = [
        axis / np.sqrt(3) + np.sqrt(2 / 3) * (np.cos(a) * u + np.sin(a) * w)
        for a in np.radians([90.0, 210.0, 330.0])
    ]
    corners = np.array([origin, *(origin + side * arm for arm in arms)])
    return corners, np.array([[0, 1, 2], [0, 2, 3], [0, 3, 1]], dtype=np.int32), 0


# ---- static proofs


def test_one_bounce_is_proven_where_it_holds(base: Scene) -> None:
    vertices, faces = sphere(1.0, 0.001)
    for mesh in (plain(60.0), box([-5, -5, 0], [5, 5, 8]), (vertices, faces, 0)):
        plan = plan_effects(scene(base, mesh))
        assert plan.max_depth == 1 and not plan.flags.multi_bounce and not plan.flags.visibility
    # two plates in one plane are flat, whatever their number
    left = quad([-9, -9, 1], [-1, -9, 1], [-1, 9, 1], [-9, 9, 1], 0)
    right = quad([1, -9, 1], [9, -9, 1], [9, 9, 1], [1, 9, 1], 0)
    assert plan_effects(scene(base, left, right)).max_depth == 1


def test_convex_looking_pairs_are_not_taken_for_convex(base: Scene) -> None:
    """Two bodies, each convex; a box on a plain; a roof seen from inside; one body whose closed shell has a notch."""
    a, b = box([-5, -5, 0], [-1, 5, 8]), box([1, -5, 0], [5, 5, 8])
    for meshes in ((a, b), (plain(60.0), box([-5, -5, 0], [5, 5, 8]))):
        context = SceneContext(scene(base, *meshes))
        assert context.shape.single_bounce == ""
    # V of two plates: bulging towards the radar (a roof) it has one bounce, opening towards it two
    radar = base.radar.track.center_position
    side = np.sign(radar[0])
    roof = [quad([0, -5, 4], [0, 5, 4], [x, 5, 0], [x, -5, 0], 0) for x in (-4, 4)]
    assert SceneContext(scene(base, *roof)).shape.single_bounce
    floor = quad([0, -5, 0], [0, 5, 0], [4 * side, 5, 0], [4 * side, -5, 0], 0)
    wall = quad([0, -5, 0], [0, 5, 0], [0, 5, 4], [0, -5, 4], 0)
    corner = SceneContext(scene(base, floor, wall))
    assert corner.shape.single_bounce == "" and corner.shape.open_sight
    # a notch: the box with a corner pushed in is closed and one piece, but not its own hull
    v, f, m = box([-5, -5, 0], [5, 5, 8])
    v = v.copy()
    v[7] = [2.0, 2.0, 5.0]
    assert SceneContext(scene(base, (v, f, m))).shape.single_bounce == ""


def test_shapes_convex_by_their_kind_are_so(base: Scene) -> None:
    """The proof finds what is taken for granted for `sphere` and `cube`, turned and stretched as well."""
    matrix = np.array([[3.0, 1.0, 0.2], [-0.5, 1.0, 0.3], [0.1, -0.7, 0.4]])
    for vertices, faces in (cube(), *(sphere(1.0, s) for s in (0.1, 0.02, 3e-3, 3e-4))):
        shape = SceneContext(scene(base, (vertices @ matrix.T, faces, 0))).shape
        assert not shape.stated_convex and shape.convex_body


def test_stated_convexity_holds_for_one_body_seen_from_outside(base: Scene) -> None:
    vertices, faces = sphere(1.0, 0.01)
    one, two = (vertices, faces, 0), (vertices + np.array([0.0, 0.0, 5.0]), faces, 0)

    def stated(target: Scene, *flags: bool) -> Scene:
        return replace(target, geometry=replace(target.geometry, mesh_convex=flags))

    def shape(target: Scene) -> ShapeAnalysis:
        return SceneContext(target).shape_within(0.0)

    assert shape(scene(base, one)).single_bounce == ""  # no time for a proof
    assert shape(stated(scene(base, one), True)).single_bounce == "one closed convex body"
    assert shape(stated(scene(base, one, two), True, True)).single_bounce == ""
    assert shape(stated(scene(base, one, plain(60.0)), True, False)).single_bounce == ""
    hidden = stated(scene(base, one, (*two[:2], 1)), True, True)
    hidden = replace(hidden, materials=(PEC, replace(SOIL, invisible=True)))
    assert shape(hidden).single_bounce
    # seen from inside it is a hall of mirrors
    hall = stated(scene(base, (vertices * 30e3, faces, 0)), True)
    assert shape(hall).single_bounce == ""
    assert load_scene(resolve("sphere")).geometry.mesh_convex == (True,)


def test_shadow_rays_stay_where_something_stands_between(base: Scene) -> None:
    assert not SceneContext(scene(base, plain(60.0), box([-5, -5, 0], [5, 5, 8]))).shape.open_sight


def test_flat_rules_need_every_vertex(base: Scene) -> None:
    """A plain with one vertex lifted by a millimetre is no longer proven flat."""
    v, f, m = plain(60.0)
    v = v.copy()
    v[2, 2] = 1e-3
    assert not SceneContext(scene(base, (v, f, m))).shape.flat


# ---- pilot


def test_tiny_trihedral_in_a_rough_plain(base: Scene) -> None:
    """0.6 m in 100 m x 100 m: one patch in 1e4 would meet it by chance; its own patch finds the third bounce."""
    target = scene(base, plain(90.0), trihedral(base, [13.0, -21.0, 0.05], 0.6))
    plan = plan_scene(target, pilot=True)
    assert plan.max_depth >= 3
    assert plan.decision("max_depth").source == "pilot"  # type: ignore[union-attr]
    assert plan.pilot["strongest_cell_from_order_db"][2] > 20.0  # far above the clutter
    # the plain alone: one bounce
    assert plan_scene(scene(base, plain(90.0)), pilot=True).max_depth == 1


def test_smooth_box_on_the_plain_needs_two(base: Scene) -> None:
    """Wall and ground: two bounces matter, and no more than wall, ground, wall."""
    plan = plan_scene(scene(base, plain(90.0), box([-6, -8, 0], [6, 8, 9])), pilot=True)
    assert 2 <= plan.max_depth <= 4


def test_mirror_that_only_a_later_part_of_the_aperture_sees(base: Scene) -> None:
    """A plate 60 m before the trihedral hides it from the first two thirds of the aperture."""
    at = np.array([0.0, 0.0, 0.3])
    corner = trihedral(base, at.tolist(), 0.6)
    middle = at + 0.2 * towards_radar(base, at)
    track = base.radar.track.position
    n = len(track)

    def crossing(i: int) -> F64:
        d = track[i] - middle
        return np.asarray(middle + 60.0 * d / np.linalg.norm(d))

    edge, far = crossing(int(0.62 * n))[1], crossing(0)[1] - 1.5
    centre = crossing(n // 2)
    low = quad(
        [centre[0], far, centre[2] - 1.5],
        [centre[0], edge, centre[2] - 1.5],
        [centre[0], edge, centre[2] + 1.5],
        [centre[0], far, centre[2] + 1.5],
        0,
    )
    target = scene(base, plain(90.0), corner, low)
    draft = plan_effects(target, warn=False)
    sampling = SamplingPlan.of(target, draft.flags)
    late = run_pilot(draft, sampling, pulses=[int(0.75 * n), n - 1])
    early = run_pilot(draft, sampling, pulses=[0, n // 4, n // 2])
    assert (
        early.peak[0, 2] < 1e-2 * late.peak[0, 2]
    )  # the scene deceives: the first half sees no third bounce
    assert plan_scene(target, pilot=True).max_depth >= 3


def test_pilot_power_is_in_square_metres(base: Scene) -> None:
    """The trihedral's patch returns its RCS, less the fade-out."""
    side = 0.6
    target = scene(base, plain(90.0), trihedral(base, [13.0, -21.0, 0.05], side))
    fine = replace(target, settings=replace(target.settings, ray_spacing=0.1))
    draft = plan_effects(fine, warn=False)
    result = run_pilot(draft, SamplingPlan.of(fine, draft.flags))
    rcs = 4 * np.pi * side**4 / (3 * base.radar.waveform.wavelength**2)
    # tol: the fade-out over the reflector, at most a factor 4 in power; discretisation
    assert 0.2 * rcs < result.peak[0, 2] < 1.2 * rcs


@pytest.mark.slow
def test_pulses_launched_together_return_as_those_launched_alone(base: Scene) -> None:
    target = scene(base, plain(90.0), trihedral(base, [13.0, -21.0, 0.05], 0.6))
    sampling = SamplingPlan.of(target)
    built = build_trace_scene(target.geometry, target.materials, base.radar.waveform.wavelength)
    flags = replace(sampling.flags, channels=CHANNELS, taper=False)
    pulses = [0, base.radar.track.n_pulses // 3, base.radar.track.n_pulses - 1]
    point, size = np.array([[13.0, -21.0, 0.05]]), np.array([1.0])
    rng = np.random.default_rng(5)
    patches = [place_patches(sampling, pulse, 40, point, size, rng) for pulse in pulses]
    together = patch_echoes(built, sampling, flags, pulses, patches, 4)
    for pulse, patch, found in zip(pulses, patches, together, strict=True):
        (alone,) = patch_echoes(built, sampling, flags, [pulse], [patch], 4)
        # tol: float32 sums, of phases relative to another range
        for name in ("power", "incident"):
            scale = getattr(alone, name).max()
            np.testing.assert_allclose(
                getattr(found, name), getattr(alone, name), rtol=1e-3, atol=1e-5 * scale
            )
        # tol: ranges in m, weighted in float32
        lit = alone.returns.slant_range != 0.0
        assert found.returns.slant_range[lit] == pytest.approx(alone.returns.slant_range[lit], abs=1e-3)
    assert together[0].power[0].max() > 0.0 and together[0].power[1].max() > 0.0


@pytest.mark.slow
def test_a_deep_pilot_has_as_few_bounces_as_settle_it(base: Scene) -> None:
    target = scene(base, plain(90.0), trihedral(base, [13.0, -21.0, 0.05], 0.6))
    draft = plan_effects(target, warn=False)
    sampling = SamplingPlan.of(target, draft.flags)
    deep, shallow = (run_pilot(draft, sampling, orders=n) for n in (64, 16))
    assert deep.n_orders == shallow.n_orders == 16 and deep.settled(target.settings.tolerance_db)
    # tol: float32 sums of more lanes in another order
    np.testing.assert_allclose(deep.mean, shallow.mean, rtol=1e-4, atol=1e-6 * shallow.mean.max())


def test_explicit_choices_are_obeyed_and_said(base: Scene) -> None:
    target = scene(base, plain(90.0), box([-6, -8, 0], [6, 8, 9]))
    asked = replace(target, settings=replace(target.settings, max_depth=1, effects={"fresnel": "off"}))
    with pytest.warns(UserWarning, match="fresnel is switched off|max_depth = 1 leaves out") as caught:
        plan = plan_scene(asked, pilot=True)
    assert len(caught) == len(plan.notes) == 2
    assert plan.max_depth == 1 and "max_depth = 1 leaves out" in plan.notes[1]
    asked = replace(target, settings=replace(target.settings, effects={"diffuse": "off"}))
    with pytest.warns(UserWarning, match="diffuse is switched off"):
        plan = plan_scene(asked, pilot=False)
    assert not plan.flags.diffuse and not plan.flags.speckle


def test_small_runs_are_not_piloted(base: Scene) -> None:
    tiny = load_scene(resolve("trihedral"))
    plan = plan_scene(tiny)
    assert not plan.pilot and plan.max_depth >= 3


def test_plan_is_json(tmp_path: Path) -> None:
    import json

    plan = plan_effects(load_scene(resolve("trihedral")))
    assert json.loads(json.dumps(plan.as_dict()))["max_depth"] == plan.max_depth
