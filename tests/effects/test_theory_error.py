"""Stated error of the theory against exact solutions: spheres, strips, square cylinders, drawn bodies by moments."""

from collections.abc import Callable
from dataclasses import replace
from types import ModuleType

import numpy as np
import pytest
import trimesh

from sarmitsuba.core.constants import SPEED_OF_LIGHT
from sarmitsuba.core.errors import SarmitsubaWarning
from sarmitsuba.core.units import db_from_power
from sarmitsuba.core.witness import Witness
from sarmitsuba.effects.omitted_waves import MetalLines, SimulatedWaves, metal_lines, omitted_energy
from sarmitsuba.effects.plan import plan_effects
from sarmitsuba.effects.theory_error import (
    STRONG_DB,
    expected_square,
    rms_db,
    theory_error,
    too_many,
    waves_left,
)
from sarmitsuba.loading.build import SceneMesh, build_scene
from sarmitsuba.radar.description import RadarDescription
from sarmitsuba.scene.materials.material import Material
from sarmitsuba.simulation.execution.error_statement import image_theory, theory_witness
from sarmitsuba.simulation.execution.turntable import Aspects, RcsSweep, rcs_sweep
from sarmitsuba.truth import theory
from sarmitsuba.truth.validation import targets

# bodies of a few wavelengths are several dB off, which is what is tested
pytestmark = pytest.mark.filterwarnings(
    "ignore:.*levels are not better than", "ignore:.*theory not known", "ignore:.*switched off"
)
CHANNELS = ("HH", "VV")
# dB by which the true error may exceed the stated one, as in the validation topic `measured`
MARGIN = 2.0
# square of 2 m in x = 0, in two triangles
SHEET = np.array([[[0.0, -1, -1], [0, 1, -1], [0, 1, 1]], [[0, -1, -1], [0, 1, 1], [0, -1, 1]]])


def swept(mesh: targets.Mesh, azimuth: np.ndarray, elevation: float = 0.0, **settings: object) -> RcsSweep:
    """Sweep by ray optics at a wavelength of 1 m."""
    vertices, faces = mesh
    scene = build_scene(
        [SceneMesh(vertices, np.asarray(faces, dtype=np.int32), "pec", "body")],
        radar=RadarDescription(center_frequency=SPEED_OF_LIGHT),
    )
    return rcs_sweep(
        scene.replace(**{"full_wave": "off", **settings}),
        Aspects(azimuth, np.full(azimuth.size, elevation)),
        channels=CHANNELS,
    )


def true_rms(found: np.ndarray, exact: np.ndarray) -> float:
    strong = exact >= exact.max() - STRONG_DB
    return float(np.sqrt(np.mean(np.square(found - exact)[strong])))


def box(a: float, b: float, c: float) -> targets.Mesh:
    body = trimesh.creation.box((a, b, c))
    return np.asarray(body.vertices), np.asarray(body.faces)


def test_mean_square_of_a_missing_wave_is_the_mean_over_its_phase() -> None:
    phase = 2.0 * np.pi * (np.arange(200_000) + 0.5) / 200_000
    for ratio in (1e-3, 0.1, 0.7, 1.0, 3.0, 100.0):
        sample = 20.0 * np.log10(np.abs(1.0 + np.sqrt(ratio) * np.exp(1j * phase)))
        # tol: the logarithm's pole at a ratio of 1, between two phases
        assert expected_square(np.array(ratio)) == pytest.approx(np.mean(sample**2), rel=1e-3)


def test_only_the_strong_part_counts() -> None:
    power = np.array([[1.0], [0.1], [1e-3]])
    weak = np.array([[0.0], [0.0], [1e-3]])
    assert rms_db(weak, power) == pytest.approx(0.0, abs=1e-6)
    assert rms_db(np.array([[0.0], [0.01], [0.0]]), power) == pytest.approx(
        np.sqrt(0.5 * expected_square(np.array(0.1)))
    )


def test_spheres_against_the_mie_series() -> None:
    """Radii drawn from 0.35 to 3 wavelengths."""
    rng = np.random.default_rng(29)
    azimuth = np.radians([0.0, 50.0])
    for radius in np.exp(rng.uniform(np.log(0.35), np.log(3.0), 6)):
        body = targets.sphere(radius, 0.004)
        sweep = swept((body.vertices, body.faces), azimuth)
        exact = float(db_from_power(np.pi * radius**2 * theory.sphere_mie(2.0 * np.pi * radius)))
        for i, channel in enumerate(CHANNELS):
            stated = sweep.statement.total_db[i]
            assert true_rms(sweep.dbsm(channel), np.full(2, exact)) < stated + MARGIN
            # the shadow boundary's false return is 1 / ka of the echo, here with the margin of a mean over shapes
            assert stated < 8.7 * 5.0 / (2.0 * np.pi * radius)


@pytest.mark.parametrize("closed", [False, True])
def test_long_strips_and_square_cylinders_against_moments_in_two_dimensions(closed: bool) -> None:
    """Widths drawn from 1.2 to 9 wavelengths, a length of 25, looked at in the plane across."""
    rng = np.random.default_rng(30 + closed)
    length, azimuth = 25.0, np.radians(np.arange(0.0, 90.0, 1.5))
    factors = []
    for width in np.exp(rng.uniform(np.log(1.2), np.log(9.0 if not closed else 5.0), 5)):
        h = 0.5 * width
        outline = [(0.0, -h), (0.0, h)] if not closed else [(-h, -h), (h, -h), (h, h), (-h, h), (-h, -h)]
        along, across = theory.strips_by_moments([outline], 1.0, azimuth, step=1.0 / 12.0)
        mesh = box(width, width, length)
        if not closed:
            corners = [[0.0, y, z] for y, z in ((-h, -12.5), (h, -12.5), (h, 12.5), (-h, 12.5))]
            mesh = np.array(corners), np.array([[0, 1, 2], [0, 2, 3]])
        sweep = swept(mesh, azimuth, edge_diffraction="on")
        for i, field in enumerate((across, along)):  # HH is across the axis
            exact = np.asarray(db_from_power(2.0 * length**2 * np.square(np.abs(field))))
            true, stated = true_rms(sweep.dbsm(CHANNELS[i]), exact), sweep.statement.total_db[i]
            print(f"width {width:.2f} {CHANNELS[i]}: true {true:.2f} dB, stated {stated:.2f} dB")
            # waves that cross a face with the field along its edges are weak, and corners are not in two dimensions
            assert stated - 3.0 < true < stated + MARGIN
            if i == 0:
                factors.append(stated / true)
    # neither optimistic nor useless; waves between the rims of a strip are simulated, so that the corners and ends that
    # are stated for a body of three dimensions are nearly all
    assert 0.4 < np.median(factors) < (4.0 if closed else 6.0)


@pytest.mark.parametrize("family", ["parallel", "tilted", "bent_alike"])
def test_bodies_side_by_side_and_bent_sheets_against_moments_in_two_dimensions(
    family: str, benchmark_script: Callable[[str], ModuleType]
) -> None:
    """Drawn pairs of sheets a tenth of a wavelength to five apart, and sheets with bends of 4 to 24 degrees."""
    drawn, study = benchmark_script("drawn_assemblies"), benchmark_script("theory_error")
    over, factor = [], []
    for entry in map(drawn.solve, drawn.drawn(429, 2, (family,))):
        sweep = study.sweep_of(entry)
        for i, channel in enumerate(CHANNELS):
            true, stated = (
                true_rms(sweep.dbsm(channel), np.array(entry[channel])),
                sweep.statement.total_db[i],
            )
            print(f"{family} {channel}: true {true:.2f} dB, stated {stated:.2f} dB")
            over.append(true - stated)
            factor.append(stated / true)
    # tol: one of fifty rows may exceed its statement, none of these by more than twice the margin
    assert sorted(over)[-2] < MARGIN and max(over) < 2.0 * MARGIN
    assert 0.5 < np.median(factor) < 4.0
    cause = "bent sheets" if family == "bent_alike" else "between bodies"
    assert cause in sweep.statement.theory.text


@pytest.mark.parametrize(
    "seed", [3, pytest.param(4, marks=pytest.mark.slow), pytest.param(5, marks=pytest.mark.slow)]
)
def test_drawn_folds_against_moments_in_two_dimensions(
    seed: int, benchmark_script: Callable[[str], ModuleType]
) -> None:
    """Plates of 1 to 20 wavelengths that meet at 40 to 140 degrees, both polarisations."""
    found = list(
        benchmark_script("theory_error").fold_errors(
            seed, 1 if seed == 3 else 8, widest=3.0 if seed == 3 else 20.0
        )
    )
    for fold in found:
        for true, stated in zip(fold.true, fold.stated, strict=True):
            print(f"{fold.text}: true {true:.2f} dB, stated {stated:.2f} dB")
            assert true < 2.0
            # tol: rays that graze a face are few, a few tenths of a dB beyond what two sets of them tell
            assert true < stated + 1.5


def test_statements_do_not_depend_on_how_a_plate_is_cut() -> None:
    looks = targets.from_azimuth(np.radians(np.arange(-60.0, 61.0, 10.0)))
    waves = SimulatedWaves(True, True, True, True)
    energies = []
    for n, m in ((1, 1), (90, 60)):
        u, v = np.meshgrid(5.0 * np.arange(n + 1) / n, 3.0 * np.arange(m + 1) / m, indexing="ij")
        points = np.stack([0.0 * u, u, v], axis=-1)
        a, b, c, d = (
            points[i : n + i, j : m + j].reshape(-1, 3) for i, j in ((0, 0), (1, 0), (1, 1), (0, 1))
        )
        corners = np.concatenate([np.stack(t, axis=1) for t in ((a, b, c), (a, c, d))])
        found = waves_left(corners, np.ones(len(corners)), looks, np.arange(len(looks)), CHANNELS, 1.0, waves)
        assert np.sort(found.lines.width[:, 0]) == pytest.approx([3.0, 3.0, 5.0, 5.0])
        energies.append(np.sum(list(found.energy.values()), axis=0))
        assert not too_many(corners, 2)
    assert energies[1] == pytest.approx(energies[0])


def test_a_channel_at_rounding_has_no_error() -> None:
    """A plate seen in the plane across its rims returns no HV."""
    vertices = np.array([[0.0, y, z] for y, z in ((-2, -1), (2, -1), (2, 1), (-2, 1))])
    scene = build_scene(
        [SceneMesh(vertices, np.array([[0, 1, 2], [0, 2, 3]], dtype=np.int32), "pec", "plate")],
        radar=RadarDescription(center_frequency=SPEED_OF_LIGHT),
    )
    azimuth = np.radians([0.0, 10.0, 20.0])
    channels = ("HH", "HV", "VV")
    sweep = rcs_sweep(scene.replace(full_wave="off"), Aspects(azimuth, 0.0 * azimuth), channels=channels)
    assert np.isnan(sweep.statement.total_db).tolist() == [False, True, False]
    error = sweep.statement.as_dict(channels)
    assert isinstance(error["theory_db"], dict) and error["theory_db"]["HV"] is None


def test_images_of_a_fold_alone_have_its_measured_error() -> None:
    """Plates of 5 wavelengths at 110 degrees, which open towards the radar; with a box beside them nothing is whole."""
    wave, (c, s) = SPEED_OF_LIGHT / 9.6e9, np.array([np.cos(0.96), np.sin(0.96)])
    radar = RadarDescription(slant_range=8000.0, look_angle_deg=45.0, center_frequency=9.6e9)
    bare = build_scene([SceneMesh(*box(1.0, 1.0, 1.0), "pec", "box")], radar=radar)
    up, along = bare.radar.track.center_position, bare.radar.track.velocity[0]
    up, along = up / np.linalg.norm(up), along / np.linalg.norm(along)
    side = np.cross(up, along)
    ends = [5.0 * wave * (c * up + sign * s * side) for sign in (-1.0, 1.0)]
    vertices = np.array([p + z * along for p in (0.0 * up, *ends) for z in (-3.0 * wave, 3.0 * wave)])
    faces = np.array([[0, 1, 2], [2, 1, 3], [0, 4, 1], [1, 4, 5]], dtype=np.int32)
    fold = SceneMesh(vertices, faces, "pec", "fold")
    for meshes, whole in (([fold], True), ([fold, SceneMesh(*box(0.5, 0.5, 0.5), "pec", "box")], False)):
        scene = build_scene(meshes, radar=radar)
        flags = replace(
            plan_effects(scene, warn=False).flags, extra=frozenset({"edge_diffraction"}), multi_bounce=True
        )
        theory_of_image = image_theory(scene, flags)
        measured = theory_witness(theory_of_image)
        assert bool(measured) == whole and "fold" in theory_of_image
        if whole:
            witness = Witness.read(measured["theory"])
            # its waves are added, so that the error left is that of the sections
            assert witness is not None and witness.error_db < -30.0 and "finer mesh" in witness.reference


@pytest.mark.slow
def test_assemblies_drawn_after_the_laws_were_fitted(benchmark_script: Callable[[str], ModuleType]) -> None:
    """Pairs of sheets, boxes and cylinders, louvres, channels, bent sheets: in two dimensions and in three."""
    found = list(benchmark_script("theory_error").errors("held_out", of="assemblies"))
    true, stated = (np.array([getattr(f, n) for f in found]).ravel() for n in ("true", "stated"))
    known = np.isfinite(stated)
    assert known.mean() > 0.9
    long = np.repeat(
        np.isin([f.family for f in found], list(benchmark_script("drawn_assemblies").PROFILES)), 2
    )
    # tol: short plates of one to two wavelengths turned edge-on, of which ray optics has next to nothing
    assert (true - stated > MARGIN)[known].mean() <= 0.04
    assert (true - stated > MARGIN)[known & long].mean() <= 0.02
    assert 0.8 < np.median((stated / true)[known]) < 2.0


@pytest.mark.slow
def test_bodies_drawn_after_the_laws_were_fitted(benchmark_script: Callable[[str], ModuleType]) -> None:
    """Plates, boxes, cylinders, ellipsoids, cones, open boxes ... of half a wavelength to five, by moments."""
    found = list(benchmark_script("theory_error").errors("held_out"))
    true, stated = (np.array([getattr(f, n) for f in found]).ravel() for n in ("true", "stated"))
    known = np.isfinite(stated)
    # nothing is known of bodies below half a wavelength, the family "tiny" and a few others
    assert known.mean() > 0.75
    over = true - stated
    # tol: three of thin plates, two wedges a thirtieth of a wavelength apart as one rim, and a cone about its axis,
    # whose pattern is the same at all aspects and lies in one null: docs/rcs.md has them
    assert (over[known] > MARGIN).sum() <= 4
    factor = stated[known] / true[known]
    assert 1.0 < np.median(factor) < 2.0 and np.quantile(factor, 0.95) < 8.0


@pytest.mark.slow
def test_drawn_bodies_as_users_run_them(benchmark_script: Callable[[str], ModuleType]) -> None:
    """The same with solved currents where they are automatic: of every body the error is known, and small."""
    found = list(benchmark_script("theory_error").errors("held_out", full_wave="auto"))
    true, stated = (np.array([getattr(f, n) for f in found]).ravel() for n in ("true", "stated"))
    assert np.isfinite(stated).all()
    # tol: the solver of the references has edges of a tenth of a wavelength, which errs by as much
    assert (true - stated).max() < 1.0
    assert np.median(true) < 0.3 and np.median(stated / true) > 0.8


@pytest.mark.slow
def test_the_exact_solver_of_the_drawn_bodies(benchmark_script: Callable[[str], ModuleType]) -> None:
    solver = benchmark_script("dense_moments")
    looks = [[1.0, 0.0, 0.0], [0.6, 0.0, 0.8]]
    for radius in (0.15, 0.3):
        s = solver.amplitudes(solver.sphere(radius, 0.05), looks)
        exact = np.pi * radius**2 * theory.sphere_mie(2.0 * np.pi * radius)
        # tol: triangles of a twentieth of a wavelength, and the inscribed body's smaller volume
        assert np.abs(db_from_power(np.square(np.abs(s))) - db_from_power(exact)).max() < 0.4


def test_missing_waves_fall_with_size_and_edges_left_out_are_said() -> None:
    azimuth = np.radians(np.arange(0.0, 90.0, 3.0))
    small, large = (swept(box(x, x, 2.0 * x), azimuth, edge_diffraction="on") for x in (2.0, 12.0))
    assert large.statement.total_db.max() < 0.4 * small.statement.total_db.max()
    bare = swept(box(12.0, 12.0, 24.0), azimuth, edge_diffraction="off")
    assert bare.statement.total_db.max() > 1.5 * large.statement.total_db.max()
    assert "edges that are not simulated" in bare.statement.text


def test_a_sheet_seen_along_its_plane_with_the_field_across_it_sends_nothing() -> None:
    lines = metal_lines(SHEET, np.ones(2), 0.5)
    assert lines.n == 4 and np.allclose(lines.width, 2.0) and np.allclose(lines.length, 2.0)
    found = omitted_energy(lines, np.array([[0.0, 1.0, 0.0]]), CHANNELS, 0.5, SimulatedWaves())
    total = np.sum(list(found.values()), axis=0)[0]
    assert total[0] < 1e-20 and total[1] > 1e-4


def test_waves_that_are_simulated_are_not_missing() -> None:
    """Double diffraction, and thin plates with one rim."""
    rng = np.random.default_rng(5)
    looks = rng.normal(size=(20, 3))
    looks /= np.linalg.norm(looks, axis=1, keepdims=True)
    vertices, faces = box(3.0, 2.0, 0.02)
    lines = metal_lines(vertices[faces], np.ones(len(faces)), 1.0)

    sheet = metal_lines(SHEET, np.ones(2), 0.5)

    def energy(of: MetalLines, **waves: bool) -> np.ndarray:
        return np.sum(
            list(omitted_energy(of, looks, CHANNELS, 1.0, SimulatedWaves(**waves)).values()), axis=0
        )

    plain, twice, rim = energy(lines), energy(sheet, between_rims=True), energy(lines, one_rim=True)
    assert (twice < energy(sheet)).all()
    assert (rim < plain).all() and rim.sum() < 0.2 * plain.sum()
    assert (energy(lines, edges=False) > plain).all()


@pytest.mark.parametrize(
    ("mesh", "material", "text"),
    [
        (box(0.2, 0.1, 0.1), "pec", "the body is 0.2 wavelengths large"),
        (box(3.0, 0.05, 0.05), "pec", "a rod"),
        (box(3.0, 2.0, 2.0), Material("glass", permittivity=4.0 - 0.01j), "surfaces of glass"),
    ],
)
def test_bodies_of_which_nothing_is_known(mesh: targets.Mesh, material: object, text: str) -> None:
    scene = build_scene(
        [SceneMesh(*mesh, material, "body")],  # type: ignore[arg-type]
        radar=RadarDescription(center_frequency=SPEED_OF_LIGHT),
    )
    found = theory_error(
        scene.geometry,
        scene.materials,
        np.array([[1.0, 0.0, 0.0]]),
        np.ones((1, 1, 2), complex),
        CHANNELS,
        1.0,
        SimulatedWaves(),
    )
    assert text in found.text and np.isinf(found.rms_db).all()


def test_repeated_bounces_in_narrow_ducts_are_doubted_and_those_of_wide_corners_are_not() -> None:
    corner = targets.dihedral(40.0, 40.0, 40.0)
    amplitude = np.zeros((1, 2, 1), complex)
    amplitude[0, 1] = 1e4  # far above the edges
    look, stated = np.array([[0.6, 0.6, 0.5]]), []
    for wavelength in (1.0, 20.0):
        found = theory_error(corner, targets.PEC, look, amplitude, ("VV",), wavelength, SimulatedWaves())
        stated.append(float(found.rms_db[0]))
    # one over the width in wavelengths: 8.69 / sqrt(2) dB times that
    assert stated[0] == pytest.approx(6.14 / 40.0, rel=0.05)
    assert stated[1] == pytest.approx(float(np.sqrt(expected_square(np.array(0.25)))), rel=0.05)


def test_a_doubtful_sweep_is_warned_of_with_the_remedy() -> None:
    # edge-on all around: the echo of a plate's thickness, with the field along it, is not simulated
    azimuth = np.radians(np.arange(0.0, 90.0, 6.0))
    with pytest.warns(SarmitsubaWarning, match="0.02 wavelengths apart.*solved currents.*full_wave is off"):
        sweep = swept(box(3.0, 2.0, 0.02), azimuth)
    found = sweep.statement.as_dict(CHANNELS)
    assert found["total_db"]["HH"] == pytest.approx(sweep.statement.total_db[0], abs=1e-3)  # type: ignore[index]
    assert "not better than" in sweep.statement.text
