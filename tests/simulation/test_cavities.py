"""Waves caught between parallel walls: as many bounces as return something are followed, and what is not is said."""

from dataclasses import replace

import numpy as np
import pytest

from sarmitsuba.core.errors import SarmitsubaWarning
from sarmitsuba.effects.plan import plan_effects
from sarmitsuba.scene.materials.material import Material
from sarmitsuba.scene.scene import Scene
from sarmitsuba.scene.settings import TraceSettings
from sarmitsuba.simulation.execution.blocks import Blocks
from sarmitsuba.simulation.execution.rcs import BouncesLeft, monostatic_rcs
from sarmitsuba.simulation.execution.run import Run
from sarmitsuba.simulation.execution.tracing import Batch
from sarmitsuba.simulation.planning.pilot import plan_scene
from sarmitsuba.truth.validation import targets
from sarmitsuba.truth.validation.band_sampling import X_BAND
from sarmitsuba.truth.validation.chain import make_scene, suppress_warnings

SMALL = {
    "slant_range": 10e3,
    "heading_deg": 0.0,
    "look_angle_deg": 75.0,
    "azimuth_resolution": 1.0,
    "bandwidth": 150e6,
    "center_frequency": X_BAND,
    "polarisation": "HH,VV",
    "speed": 150.0,
    "aim_x": 0.0,
    "aim_y": 0.0,
    "aim_z": 0.0,
    "image_extent_azimuth": 16.0,
    "image_extent_range": 12.0,
}


def duct(turn: float, length: float = 2.0, width: float = 0.3) -> list[targets.Mesh]:
    """A square duct of four walls and an end, open towards azimuth ``turn`` (rad)."""
    half, walls = 0.5 * width, []
    c, s = np.cos(turn), np.sin(turn)
    about = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
    for corner, a, b in (
        ([0, -half, -half], [0, width, 0], [0, 0, width]),
        ([0, -half, -half], [length, 0, 0], [0, width, 0]),
        ([0, -half, half], [length, 0, 0], [0, width, 0]),
        ([0, -half, -half], [length, 0, 0], [0, 0, width]),
        ([0, half, -half], [length, 0, 0], [0, 0, width]),
    ):
        vertices, faces = targets.parallelogram(corner, a, b)
        walls.append((np.asarray(vertices) @ about, faces))
    return walls


def scene_of(meshes: list[targets.Mesh], material: Material | None = None, **settings: int) -> Scene:
    materials = targets.PEC if material is None else (material,)
    return make_scene(
        targets.geometry(meshes, [0] * len(meshes)),
        materials,
        SMALL,
        settings=TraceSettings(ray_spacing=0.02, **settings),
    )


def test_rcs_of_a_duct_has_all_its_bounces() -> None:
    """From 60 degrees off its axis all that comes back has gone through more than eight bounces."""
    geometry = targets.geometry(duct(0.0), [0] * 5)
    look = [[np.cos(a) * np.cos(0.12), np.sin(a) * np.cos(0.12), np.sin(0.12)] for a in (0.0, 0.8, 1.05)]
    levels = {
        depth: monostatic_rcs(geometry, targets.PEC, look, X_BAND, max_depth=depth) for depth in (8, 64, 0)
    }
    eight, all_, automatic = (levels[d].rcs_dbsm("HH") for d in (8, 64, 0))
    assert (all_ - eight).max() > 20.0
    assert np.abs(automatic - all_).max() < 0.02  # tol: -40 dB of what all return
    assert levels[8].unfinished.any() and not levels[64].unfinished.any()
    assert 8 < levels[0].max_depth < 64


def test_rcs_keeps_eight_bounces_where_they_are_enough() -> None:
    corner = targets.trihedral(0.3, "triangular")
    geometry = targets.geometry([(corner.vertices, corner.faces)], [0])
    result = monostatic_rcs(geometry, targets.PEC, [[1.0, 1.0, 1.0]], X_BAND)
    assert result.max_depth == 8 and not result.unfinished.any()


def test_the_plan_of_a_short_run_follows_a_duct_to_its_end() -> None:
    plan = plan_scene(scene_of(duct(np.radians(225.0))))
    assert plan.max_depth > 8 and plan.decisions[0].source == "pilot"
    with pytest.warns(
        SarmitsubaWarning, match=f"max_depth = 8 leaves out .*set max_depth = {plan.max_depth} or auto"
    ):
        closed = plan_scene(scene_of(duct(np.radians(225.0)), max_depth=8))
    assert closed.max_depth == 8


def test_walls_that_take_from_every_wave_need_fewer() -> None:
    """A duct of wood: what goes on after eight bounces is below the tolerance."""
    wood = Material("wood", permittivity=2.0 - 0.2j)
    scene = scene_of(duct(np.radians(225.0)), wood)
    assert plan_scene(scene).max_depth <= plan_effects(scene).max_depth == 8


def test_no_pilot_where_nothing_looks_at_anything(monkeypatch: pytest.MonkeyPatch) -> None:
    """A corner has no faces turned towards each other: its plan costs what it did."""
    from sarmitsuba.simulation.planning import pilot

    corner = targets.trihedral(0.6, "triangular")
    scene = scene_of([(corner.vertices, corner.faces)])
    monkeypatch.setattr(pilot, "run_pilot", lambda *a, **k: pytest.fail("a pilot ran"))
    assert plan_scene(scene).max_depth == 8


def test_bounces_left_are_found_or_said() -> None:
    """A series that falls by a tenth of its power at every bounce, and one that never falls."""

    def falling(depth: int) -> np.ndarray:
        return (0.1 ** (0.5 * np.arange(depth)))[None, :, None].astype(complex)

    left = BouncesLeft.of(falling, 2)
    assert left.enough and left.depth == 4 and left.left_db < -40.0
    assert not left.notes("x", 5) and "set max_depth to auto" in left.notes("x", 3)[0]
    never = BouncesLeft.of(lambda depth: np.ones((1, depth, 1), dtype=complex), 8, most=64)
    assert not never.enough and never.depth == 64 and "bounce 64 still returns" in never.notes("x", 64)[0]


@pytest.mark.parametrize("turned", [False, True])
@pytest.mark.parametrize("place", [0.0, 0.5, 1.0])
def test_a_facet_stands_for_its_slab_wherever_it_is_drawn(place: float, turned: bool) -> None:
    """The phase of the echo of a pane square on is that of its near face, from either side of the facet."""
    thickness, wavelength = 0.012, 299792458.0 / X_BAND
    glass = Material("pane", permittivity=6.31 - 0.19j, thickness=thickness, facet_depth=place)
    flipped = Material("pane", permittivity=6.31 - 0.19j, thickness=thickness)
    size = [0.3, 0.3]

    def echo(x: float, material: Material, away: bool) -> complex:
        a, b = ([0, 0, size[1]], [0, size[0], 0]) if away else ([0, size[0], 0], [0, 0, size[1]])
        mesh = targets.parallelogram([x, -0.15, -0.15], a, b)
        result = monostatic_rcs(
            targets.geometry([mesh], [0]),
            (material,),
            [[1.0, 0.0, 0.0]],
            X_BAND,
            max_depth=1,
            ray_spacing=0.02,
        )
        return complex(result.amplitude[0, 0, 0] * np.exp(4j * np.pi / wavelength * x))

    # the slab's near face at x = 0
    behind = (1.0 - place if turned else place) * thickness
    want, got = echo(0.0, flipped, False), echo(-behind, glass, turned)
    assert abs(got / want - 1.0) < 2e-3  # tol: float32 phases


@pytest.mark.parametrize("seed", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_a_path_behind_panes_is_its_own_whatever_its_neighbours_do(seed: int) -> None:
    """Rays in any order return the same: each lane's waiting paths are where it left them."""
    rng = np.random.default_rng([26, seed])
    ground = Material("soil", permittivity=5.0 - 0.5j)
    panes = [
        Material(f"pane {i}", permittivity=6.3 - 0.1j, thickness=rng.uniform(3e-3, 8e-3)) for i in range(2)
    ]
    meshes = [targets.parallelogram([-3.0, -3.0, 0.0], [6.0, 0.0, 0.0], [0.0, 6.0, 0.0])]
    for x, turn in zip((0.3, 0.5), rng.uniform(-0.1, 0.1, 2), strict=True):
        across = np.array([np.sin(turn), np.cos(turn), 0.0])
        meshes.append(targets.parallelogram([x, -1.0, 0.1], 2.0 * across, [0.0, 0.0, rng.uniform(0.8, 1.6)]))
    box = targets.parallelogram([1.0, -0.5, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0])
    radar = {**SMALL, "heading_deg": float(rng.choice([0.0, 180.0])), "look_angle_deg": 60.0}
    scene = make_scene(
        targets.geometry([*meshes, box], [0, 1, 2, 3]),
        (ground, *panes, *targets.PEC),
        radar,
        settings=TraceSettings(ray_spacing=0.05, max_depth=12, effects={"wideband": "off"}),
    )
    with suppress_warnings():
        run = Run(scene)
    assert run.sampling is not None and run.plan.on("transmission")
    rays, layers = run.rays(run.sampling, 0), run.layers.layers
    shape = (len(layers), scene.radar.track.n_pulses, scene.radar.window.n_samples)
    blocks = Blocks(
        run.tracer(run.sampling), rays, layers, np.zeros(shape, np.complex64), run.layers.max_order
    )
    grids = rays.at(0)[0]
    mixed = []
    for grid in grids:
        order = rng.permutation(grid.n_rays)
        assert not grid.levels  # which keep their rays together
        mixed.append(replace(grid, x=grid.x[order], y=grid.y[order]))
    pulse = Batch(0, 0, 1, together=True)
    there, again = (blocks.batches.trace(pulse, each).profiles for each in (grids, mixed))
    # tol: sums in another order; lanes that share memory end the process
    assert np.linalg.norm(there - again) < 1e-5 * np.linalg.norm(there)
