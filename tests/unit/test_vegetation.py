"""Vegetation: permittivity of plants, single pieces, means over orientations, and how scenes describe volumes."""

from pathlib import Path

import numpy as np
import pytest

from sarmitsuba import RadarDescription, SceneMesh, SceneVolume, build_scene, load_scene
from sarmitsuba.core.constants import SPEED_OF_LIGHT
from sarmitsuba.core.errors import SceneError
from sarmitsuba.scene.materials.vegetation import canopy, plant_pieces
from sarmitsuba.scene.materials.vegetation.canopy import (
    CANOPIES,
    NODES,
    Canopy,
    Constituent,
    Orientation,
    node_cosines,
    plant_permittivity,
    water_cloud,
)
from sarmitsuba.scene.materials.vegetation.plant_pieces import Leaf, OverGround, Stick, thin_rod
from sarmitsuba.scene.mesh import tessellate
from sarmitsuba.scene.scene import Scene
from sarmitsuba.truth import theory

GROUND = SceneMesh(
    np.array([[-9.0, -9, 0], [9, -9, 0], [9, 9, 0], [-9, 9, 0]]), [[0, 1, 2], [0, 2, 3]], "concrete", "ground"
)
BANDS = {"L": 1.27e9, "C": 5.4e9, "X": 9.65e9}


@pytest.mark.parametrize("seed", range(4))
def test_permittivity_is_that_of_the_closed_form(seed: int) -> None:
    rng = np.random.default_rng(seed)
    for _ in range(20):
        moisture, frequency = rng.uniform(0.0, 0.7), 10 ** rng.uniform(8.3, 10.3)
        assert plant_permittivity(moisture, frequency) == pytest.approx(
            complex(theory.plant_permittivity(moisture, frequency)), rel=1e-12
        )


def test_permittivity_of_dry_plants_is_that_of_dry_matter() -> None:
    assert plant_permittivity(0.0, 5e9) == 1.7
    assert plant_permittivity(0.65, 5e9).imag < 0.0  # loss under exp(+j w t)


@pytest.mark.parametrize("seed", range(4))
def test_the_series_of_a_cylinder_meets_the_closed_form_at_broadside(seed: int) -> None:
    """Another form of the coefficients, under the other time convention: magnitudes and the ratio of both."""
    rng = np.random.default_rng(seed)
    wavelength, radius = rng.uniform(0.02, 0.25), rng.uniform(0.002, 0.03)
    eps = complex(rng.uniform(3.0, 30.0), -rng.uniform(0.1, 12.0))
    for turn in (0.0, np.pi):
        ours = plant_pieces.cylinder_series(
            np.array([0.5 * np.pi]), 2.0 * np.pi * radius / wavelength, eps, turn
        )
        along, across = theory.cylinder_at_broadside(radius, eps, wavelength, turn)
        assert ours[0][0] * 1j == pytest.approx(complex(along), rel=1e-6)
        assert ours[1][0] * 1j == pytest.approx(complex(across), rel=1e-6)


def test_a_long_thin_stick_is_polarised_as_its_series_says() -> None:
    """The endless rod of the integral equation and the series of the cylinder, forwards, off the axis."""
    angle, k, eps, radius = np.array([0.7, 1.1, 0.5 * np.pi]), 2.0 * np.pi / 0.05, 15.0 - 5.0j, 2e-4
    along, across = thin_rod(radius, 1.0, k, eps).of_endless(np.cos(angle), np.cos(angle))
    series = plant_pieces.cylinder_series(angle, k * radius, eps, 0.0)
    gain = k**2 / 4.0 * radius**2 * (eps - 1.0)  # T of f = (l / pi) T
    for a, b in zip((along * np.sin(angle) ** 2 + across * np.cos(angle) ** 2, across), series, strict=True):
        # tol: second order in k a |sqrt eps| = 0.1
        assert np.abs(np.pi * gain * a - b).max() < 0.01 * np.abs(b).max()


@pytest.mark.parametrize("piece", [Leaf(0.004, 0.0002), Stick(2e-4, 0.008)])
def test_small_pieces_take_what_they_absorb_and_scatter(piece: Leaf | Stick) -> None:
    """Without loss the extinction is what is scattered; for small pieces a dipole's."""
    wavelength, eps, angle = 0.3, 20.0 + 0.0j, np.array([0.3, 1.2])
    back, taken = piece.backscatter(angle, wavelength, eps), piece.extinction(angle, wavelength, eps)
    # |S|^2 = k^4 a^2 / 4 pi across the axis, where the dipole lies across the wave
    assert taken[1] == pytest.approx(np.abs(back[1]) ** 2 * 2.0 / 3.0, rel=0.02)  # tol: size, (k l)^2 / 10
    lossy = piece.extinction(angle, wavelength, eps - 5.0j)
    assert (lossy[0] > 3.0 * taken[0]).all() and (lossy[1] > taken[1]).all()


def test_leaves_keep_the_optical_theorem() -> None:
    """A large leaf: extinction against what the endless sheet absorbs and throws both ways, per area."""
    leaf, wavelength, eps, angle = Leaf(0.05, 2e-4), 0.03, 22.0 - 8.0j, np.array([0.4])
    k, cosine = 2.0 * np.pi / wavelength, np.cos(0.4)
    sheet = 0.5j * k * leaf.thickness * (eps - 1.0)
    gamma = -sheet / cosine / (1.0 + sheet / cosine)
    # absorbed, reflected, and taken out of the wave that goes on
    per_area = (1.0 - abs(gamma) ** 2 - abs(1.0 + gamma) ** 2) + abs(gamma) ** 2 + abs(gamma) ** 2
    area = np.pi * leaf.radius**2 * cosine
    assert leaf.extinction(angle, wavelength, eps)[1][0] == pytest.approx(per_area * area, rel=1e-9)


@pytest.mark.parametrize("tilt", [0.0, 40.0, 90.0])
def test_means_over_all_directions_alike(tilt: float) -> None:
    """Small sticks in all directions against the closed form, at every angle of the wave."""
    stick, frequency, moisture = Stick(1e-4, 4e-3), 1.3e9, 0.6
    medium = Canopy("test", "", (Constituent(stick, 1.0, moisture, Orientation(tilt)),)).medium(frequency)
    eps = plant_permittivity(moisture, frequency)
    at = stick.backscatter(np.array([0.0, 0.5 * np.pi]), SPEED_OF_LIGHT / frequency, eps)
    hh, hv, product = theory.isotropic_orientation(complex(at[1][1]), complex(at[0][1]))
    assert medium.back.power == pytest.approx(
        np.tile([hh, hh, hv], (NODES, 1)), rel=2e-3
    )  # tol: (k l)^2 / 10 and sums
    assert medium.back.product == pytest.approx(np.full(NODES, product), rel=2e-3)
    assert np.ptp(medium.extinction) < 1e-3 * medium.extinction.max()


@pytest.mark.parametrize("node", [6, 8, 12])
def test_means_over_the_ground(node: int) -> None:
    """Small sticks in all directions alike: V of the way in and of the way out are twice the grazing angle apart."""
    stick, frequency, moisture = Stick(1e-4, 4e-3), 1.3e9, 0.6
    medium = Canopy("test", "", (Constituent(stick, 1.0, moisture),)).medium(frequency)
    at = stick.backscatter(
        np.array([0.0, 0.5 * np.pi]), SPEED_OF_LIGHT / frequency, plant_permittivity(moisture, frequency)
    )
    apart = 1.0 - 2.0 * node_cosines()[node] ** 2
    wanted = [theory.isotropic_between(complex(at[1][1]), complex(at[0][1]), c) for c in (1.0, apart, 0.0)]
    assert medium.over_ground.power[node] == pytest.approx(wanted, rel=5e-3)  # tol: (k l)^2 / 10 and sums


def test_a_thin_stick_over_the_ground_is_the_same_by_both_approximations(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    rng = np.random.default_rng(5)
    axis = rng.normal(size=(3, 40))
    axis /= np.linalg.norm(axis, axis=0)
    stick, wavelength, eps = Stick(2e-4, 0.02), 0.05, 15.0 - 5.0j
    view = OverGround(0.6, *axis)
    thin = np.stack(stick.over_ground(view, wavelength, eps))
    monkeypatch.setattr(plant_pieces, "THIN", 1e-6)
    series = np.stack(stick.over_ground(view, wavelength, eps))
    powers = [np.mean(np.abs(s) ** 2, axis=1) for s in (thin, series)]
    # tol: a stick of half a wave does not keep to the cone; levels of the mean, dB
    assert np.abs(10.0 * np.log10(powers[1] / powers[0])).max() < 1.0


def test_stalks_return_over_the_ground() -> None:
    """Upright long stalks mirror towards the ground and hardly backwards: of a dihedral, by the closed form."""
    stalk = Stick(0.01, 0.2)
    medium = Canopy("test", "", (Constituent(stalk, 1.0, 0.7, Orientation(0.0, 2.0)),)).medium(5e9)
    back, ground = medium.back.power[10], medium.over_ground.power[10]
    assert ground[0] > 20.0 * back[0]
    wavelength, angle = SPEED_OF_LIGHT / 5e9, np.arccos(node_cosines()[10])
    series = plant_pieces.cylinder_series(
        np.array([angle]), 2.0 * np.pi / wavelength * 0.01, plant_permittivity(0.7, 5e9), np.pi
    )
    assert ground[0] == pytest.approx(
        4.0 * 0.2**2 / np.pi * abs(series[1][0]) ** 2, rel=0.15
    )  # tol: tilts of two degrees


def test_upright_sticks_tell_v_from_h() -> None:
    upright = Canopy("test", "", (Constituent(Stick(5e-4, 0.05), 1.0, 0.5, Orientation(0.0, 5.0)),)).medium(
        5e9
    )
    extinction, power = upright.at(np.cos(np.radians(50.0)))
    assert extinction[1] > 3.0 * extinction[0] and power[1] > 10.0 * power[0]


@pytest.mark.parametrize(
    "name", [n if n == "hedge" else pytest.param(n, marks=pytest.mark.slow) for n in CANOPIES.names]
)
def test_presets_follow_the_bands(name: str) -> None:
    """Shorter waves find more in a crown; the covariance is one; no level is beyond what trees return."""
    media = [CANOPIES[name].medium(frequency) for frequency in BANDS.values()]
    taken = [float(medium.at(0.77)[0].mean()) for medium in media]
    assert taken[0] < taken[1] < taken[2]
    for medium in media:
        first, second, mixed, cross = medium.back.factors
        hh, vv, hv = medium.back.power.T
        assert (np.abs(medium.back.product) ** 2 <= hh * vv * (1.0 + 1e-9)).all()
        assert np.abs(mixed) ** 2 + second**2 == pytest.approx(vv)
        assert first * mixed == pytest.approx(np.conj(medium.back.product)) and cross**2 == pytest.approx(hv)
        # gamma0 of a deep crown: no more than that of scatterers that absorb nothing, -1 dB
        assert (medium.back.power[:, :2] / (2.0 * medium.extinction)).max() < 0.8


def cube(
    half: float = 1.0, at: tuple[float, float, float] = (0.0, 0.0, 2.0)
) -> tuple[np.ndarray, np.ndarray]:
    vertices, faces = tessellate.cube()
    return vertices * half + np.asarray(at), faces


def scene(*volumes: SceneVolume, frequency: float = 9.65e9) -> Scene:
    return build_scene([GROUND], volumes=volumes, radar=RadarDescription(center_frequency=frequency))


def test_volumes_of_one_description_share_their_medium() -> None:
    made = scene(SceneVolume(*cube(), "hedge", "a"), SceneVolume(*cube(at=(4.0, 0, 2)), "hedge", "b"))
    assert made.volumes[0].medium is made.volumes[1].medium
    assert made.volumes[0].content == pytest.approx(8.0) and made.volumes[0].mean_chord == pytest.approx(
        4.0 / 3.0
    )
    assert "2 volumes" in repr(made)


def test_a_cloud_takes_given_figures() -> None:
    values = {"sigma_v_h_db": -10.0, "sigma_v_v_db": -13.0, "extinction_h": 0.2, "extinction_v": 0.5}
    medium = scene(SceneVolume(*cube(), {**values, "volume_cross_ratio_db": -10.0})).volumes[0].medium
    extinction, power = medium.at(0.4)
    assert extinction == pytest.approx([0.2, 0.5])
    assert power == pytest.approx([0.1, 10**-1.3, 0.1 * np.sqrt(0.1 * 10**-1.3)])


def test_plants_by_their_own_figures() -> None:
    """A hedge from its own numbers is the preset; with relative_density, so many times as much of all of it."""
    figures = {"leaf_density": 900.0, "leaf_radius": 0.015, "leaf_thickness": 3e-4, "leaf_moisture": 0.6}
    sticks = {"stick_density": 10.0, "stick_radius": 0.004, "stick_length": 0.4}
    tilted = {"stick_tilt_deg": 30.0, "stick_spread_deg": 30.0}
    medium = scene(SceneVolume(*cube(), {**figures, **sticks, **tilted})).volumes[0].medium
    parts = CANOPIES["hedge"].constituents
    wanted = Canopy("some", "", (parts[0], parts[2])).medium(9.65e9)
    assert medium.back.power == pytest.approx(wanted.back.power) and medium.extinction == pytest.approx(
        wanted.extinction
    )
    twice = scene(SceneVolume(*cube(), {"preset": "hedge", "relative_density": 2.0})).volumes[0].medium
    assert twice.back.power == pytest.approx(2.0 * CANOPIES["hedge"].medium(9.65e9).back.power)


def test_inward_meshes_are_turned() -> None:
    vertices, faces = cube()
    made = scene(SceneVolume(vertices, faces[:, ::-1], "hedge"))
    assert made.volumes[0].content == pytest.approx(8.0)


@pytest.mark.parametrize(
    ("faces", "medium", "words"),
    [
        (slice(0, 11), "hedge", "is not closed"),
        (slice(0, 12), "hedgerow", 'did you mean "hedge"'),
        (slice(0, 12), {"preset": "hedge", "extinction_h": 1.0}, "describe the volume twice"),
        (slice(0, 12), {}, "the volume has no content"),
        (slice(0, 12), {"sigma_v_h_db": -10.0, "relative_density": 2.0}, "relative_density needs a preset"),
        (
            slice(0, 12),
            {"sigma_v_h_db": -10.0, "leaf_density": 9.0},
            "leaf_density and sigma_v_h_db describe",
        ),
        (slice(0, 12), {"leaf_density": 9.0, "leaf_spread_deg": 1.0}, "below the bound 2 deg"),
        (slice(0, 12), {"sigma_v_h_db": -10.0, "extinction_h": -1.0}, "below the bound 0 1/m"),
    ],
)
def test_wrong_volumes_are_refused_in_one_line(faces: slice, medium: object, words: str) -> None:
    vertices, all_faces = cube()
    with pytest.raises(SceneError, match=words) as caught:
        scene(SceneVolume(vertices, all_faces[faces], medium, "crown"))  # type: ignore[arg-type]
    assert "\n" not in str(caught.value)


def test_a_volume_needs_ground() -> None:
    with pytest.raises(SceneError, match="no surface below the volume"):
        build_scene(volumes=[SceneVolume(*cube(), "hedge", "crown")])


TREE = """<scene version="3.0.0">
    <sensor type="sar_antenna"><film type="range_film"/></sensor>
    <bsdf type="radar_volume" id="crown"><string name="preset" value="hedge"/></bsdf>
    <shape type="rectangle"><bsdf type="radar_material"><string name="material" value="concrete"/></bsdf></shape>
    {shape}
</scene>"""


def test_shapes_of_a_file_become_volumes(tmp_path: Path) -> None:
    shape = """<shape type="sphere" id="tree"><float name="radius" value="2"/>
        <transform name="to_world"><scale z="1.5"/><translate z="4"/></transform><ref id="crown"/></shape>"""
    path = tmp_path / "scene.xml"
    path.write_text(TREE.format(shape=shape))
    made = load_scene(path)
    assert made.geometry.n_faces == 2 and [v.name for v in made.volumes] == ["tree"]
    # tol: facets keep their mean distance from the centre, not the volume
    assert made.volumes[0].content == pytest.approx(4.0 / 3.0 * np.pi * 12.0, rel=0.01)
    assert made.volumes[0].bounds[:, 2] == pytest.approx([1.0, 7.0], abs=0.03)


@pytest.mark.filterwarnings("ignore::sarmitsuba.core.errors.SarmitsubaWarning")  # of the adapter
@pytest.mark.parametrize(
    ("shape", "words"),
    [
        ('<shape type="cylinder"><ref id="crown"/></shape>', "is not closed"),
        (
            '<shape type="cube"><string name="velocity" value="1 0 0"/><ref id="crown"/></shape>',
            "cannot move",
        ),
        ('<shape type="cube"><bsdf type="twosided"><ref id="crown"/></bsdf></shape>', "cannot be nested"),
    ],
)
def test_wrong_shapes_are_refused(tmp_path: Path, shape: str, words: str) -> None:
    path = tmp_path / "scene.xml"
    path.write_text(TREE.format(shape=shape))
    with pytest.raises(SceneError, match=words):
        load_scene(path)


def test_a_cloud_without_returns_has_no_root_of_nothing() -> None:
    first, second, mixed, cross = water_cloud("dark", (0.0, 0.0), (1.0, 1.0), 0.0).back.factors
    assert not np.concatenate([first, second, np.abs(mixed), cross]).any()


def test_orientations_are_normalised() -> None:
    orientation = Orientation(50.0, 20.0)
    tilt = np.radians(np.linspace(0.0, 90.0, 2001))
    total = 2.0 * np.pi * np.trapezoid(orientation.density(np.cos(tilt)) * np.sin(tilt), tilt)
    assert orientation.total == pytest.approx(total, rel=1e-3)
    assert canopy.Orientation().total == pytest.approx(2.0 * np.pi)
