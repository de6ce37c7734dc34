"""Level ground goes on beyond its rim: pixels at the rim of a patch against those of ground ten times as wide."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh

from sarmitsuba import cli
from sarmitsuba.core.arrays import F64, I64
from sarmitsuba.core.errors import RadarError, SceneError
from sarmitsuba.loading.build import MaterialLike, SceneMesh, build_scene
from sarmitsuba.loading.load import load_scene
from sarmitsuba.radar.description import RadarDescription
from sarmitsuba.radar.film import FilmDescription
from sarmitsuba.scene.ground import continue_ground, level_rim, outline
from sarmitsuba.scene.mesh.tessellate import cube
from sarmitsuba.scene.motion import Motion
from sarmitsuba.scene.scene import Scene
from sarmitsuba.scene.settings import Method, Switch, TraceSettings
from sarmitsuba.signal.image import SarImage
from sarmitsuba.simulation.execution.rcs import Aspects
from sarmitsuba.simulation.execution.render import render
from sarmitsuba.simulation.execution.turntable import rcs_sweep

HALF = 30.0
L_BAND, X_BAND = 1.3e9, 9.6e9


def square(half: float, corners: int = 4) -> tuple[F64, I64]:
    """A level square, or another regular polygon, as triangles about its first corner."""
    angle = 2.0 * np.pi * (np.arange(corners) + 0.5) / corners
    points = np.stack([np.cos(angle), np.sin(angle), 0.0 * angle], axis=1) * half / np.cos(np.pi / corners)
    rest = np.arange(1, corners - 1)
    return points, np.stack([0 * rest, rest, rest + 1], axis=1)


NARROW = FilmDescription(image_grid="ground", image_extent_azimuth=90.0, image_extent_range=90.0)


def scene_with(
    half: float,
    switch: Switch,
    *,
    material: str = "asphalt",
    frequency: float = L_BAND,
    heading: float = 1.0,
    polarisation: str = "VV",
    method: Method = "hybrid",
    box: tuple[float, float] | None = None,
    corners: int = 4,
    resolution: float = 1.0,
) -> Scene:
    """A patch of ground, with a block on it or without, in an image larger than a patch of 60 m."""
    meshes = [SceneMesh(*square(half, corners), material, "ground")]
    if box is not None:
        v, f = cube()
        block = v * np.array([2.0, 2.5, 2.0]) + np.array([*box, 2.0])
        meshes.append(SceneMesh(block, f, "concrete", "block"))
    return build_scene(
        meshes,
        radar=RadarDescription(
            slant_range=5000.0,
            look_angle_deg=40.0,
            center_frequency=frequency,
            bandwidth=150e6,
            azimuth_resolution=resolution,
            polarisation=polarisation,
            heading_deg=heading,
            aim_x=0.0,
            aim_y=0.0,
            aim_z=0.0,
        ),
        film=FilmDescription(
            image_grid="ground",
            image_extent_azimuth=90.0,
            image_extent_range=90.0,
            pixel_spacing_azimuth=0.5 * resolution,
            pixel_spacing_range=0.75,
        ),
        settings=TraceSettings(method=method, endless_ground=switch),
    )


def sheet(x: tuple[float, float], y: tuple[float, float], z: float, material: str, name: str) -> SceneMesh:
    """A level rectangle, a mirror."""
    v = np.array([[x[0], y[0], z], [x[1], y[0], z], [x[1], y[1], z], [x[0], y[1], z]])
    return SceneMesh(v, np.array([[0, 1, 2], [0, 2, 3]]), {"material": material, "smooth": True}, name)


def slab(x: tuple[float, float], y: tuple[float, float], z: float, material: str, name: str) -> SceneMesh:
    """The same rectangle as the top of a closed body 0.3 m thick."""
    v, f = cube()
    size = np.array([np.ptp(x), np.ptp(y), 0.3]) / 2.0
    place = np.array([np.mean(x), np.mean(y), z - 0.15])
    return SceneMesh(v * size + place, f, {"material": material, "smooth": True}, name)


def in_parts(rng: np.random.Generator, half: float, far: float, *, steps: float = 0.0, slabs: bool = False):  # type: ignore[no-untyped-def]
    """Meshes of ground of a square of ``2 half`` in drawn parts, and of the same with its outer parts ``far`` wide.

    Two rows, each cut at places of its own, so that corners of one lie on sides of the other.
    """
    materials = ["concrete", "wet_ground", "marble", "asphalt", *([] if steps or slabs else ["pec"])]
    y_cut = float(rng.uniform(-0.5, 0.5) * half)
    own, wide = [], []
    for row, (y, y_wide) in enumerate((((-half, y_cut), (-far, y_cut)), ((y_cut, half), (y_cut, far)))):
        cuts = np.sort(rng.uniform(-0.8, 0.8, 2) * half)
        for i, (a, b) in enumerate(zip([-half, *cuts], [*cuts, half], strict=True)):
            x_wide = (-far if i == 0 else a, far if i == 2 else b)
            material, z = str(rng.choice(materials)), float(rng.uniform(0.0, steps))
            make = slab if slabs else sheet
            own.append(make((a, b), y, z, material, f"part {row}{i}"))
            wide.append(sheet(x_wide, y_wide, z, material, f"part {row}{i}"))
    return own, wide


def image_of(scene: Scene) -> SarImage:
    return render(scene, range_window="taylor", azimuth_window="taylor")


def power_and_depth(image: SarImage, half: float = HALF) -> tuple[F64, F64]:
    """Power of every pixel, and its distance inside the rim of a square patch, m."""
    power = np.abs(image.data.reshape(-1, *image.data.shape[-2:])[0]) ** 2
    return power, half - np.abs(image.grid.positions()[..., :2]).max(axis=-1)


def change_db(image: SarImage, other: SarImage, inside: float) -> float:
    """Energy of the difference of two images relative to the second, dB, of pixels so far inside the rim, m."""
    _, depth = power_and_depth(other)
    a, b = (x.data.reshape(-1, *x.data.shape[-2:])[:, depth > inside] for x in (image, other))
    return float(10.0 * np.log10(np.sum(np.abs(a - b) ** 2) / np.sum(np.abs(b) ** 2) + 1e-30))


# the rim of ground that ends flashes up between key pulses and rays, which the runs say
@pytest.mark.filterwarnings("ignore:.*(measured in this run|measured against)")
@pytest.mark.parametrize("polarisation", ["VV", pytest.param("HH", marks=pytest.mark.slow)])
def test_the_rim_of_a_patch_of_asphalt_is_no_line(polarisation: str) -> None:
    """A patch of 60 m within the image, one degree off broadside, against its own middle and against 600 m."""
    wide = image_of(scene_with(10.0 * HALF, "auto", polarisation=polarisation))
    ends = image_of(scene_with(HALF, "off", polarisation=polarisation))
    goes_on = image_of(scene_with(HALF, "auto", polarisation=polarisation))
    level = {}
    for name, image in (("wide", wide), ("ends", ends), ("goes on", goes_on)):
        power, depth = power_and_depth(image)
        rim = np.abs(depth) < 1.0
        level[name] = 10.0 * np.log10(power[rim].mean() / power[(depth > 4.0)].mean())
    # tol: clutter ends at the rim, over a cell of 1.2 m: between that of the middle and 6 dB less
    assert level["wide"] - 6.0 < level["goes on"] < level["wide"]
    assert level["ends"] > level["wide"] + 2.0  # the line that this is about
    # tol: side lobes of taylor, -35 dB, in two dimensions, of the clutter that the patch does not have beyond its rim
    assert change_db(goes_on, wide, 4.0) < -29.0


# the rim of ground that ends flashes up between key pulses and rays, which the runs say
@pytest.mark.filterwarnings("ignore:.*(measured in this run|measured against)")
@pytest.mark.parametrize("method", ["hybrid", "image"])
def test_metal_ground_under_a_block_is_that_of_ten_times_the_size(method: Method) -> None:
    """Fringe currents at the rim of metal, and double bounces of a block near the rim."""
    images = {
        (half, switch): image_of(
            scene_with(
                half, switch, material="pec", frequency=X_BAND, heading=3.0, method=method, box=(-26.0, 3.0)
            )
        )
        for half, switch in ((10.0 * HALF, "auto"), (HALF, "off"), (HALF, "auto"))
    }
    wide, ends, goes_on = images.values()
    whole = -np.inf
    # tol: rounding of float32 positions; metal has no clutter, so that all of the image agrees
    assert change_db(goes_on, wide, whole) < -60.0
    assert change_db(ends, wide, whole) > -15.0


def seen(
    meshes: list[SceneMesh],
    rng: np.random.Generator,
    switch: Switch = "auto",
    method: Method = "hybrid",
    **radar: object,
) -> Scene:
    """Ground with a block on it near the rim, where metal radar draws its heading from ``rng``."""
    v, f = cube()
    block = v * np.array([2.0, 2.5, 2.0]) + np.array([-22.0, 3.0, 2.5])
    given: dict[str, object] = {"azimuth_resolution": 3.0, "polarisation": "VV", **radar}
    return build_scene(
        [*meshes, SceneMesh(block, f, {"material": "concrete", "smooth": True}, "block")],
        radar=RadarDescription(
            slant_range=5000.0,
            look_angle_deg=40.0,
            center_frequency=L_BAND,
            bandwidth=75e6,
            heading_deg=float(rng.uniform(0.0, 360.0)),
            aim_x=0.0,
            aim_y=0.0,
            aim_z=0.0,
            **given,  # type: ignore[arg-type]
        ),
        film=NARROW,
        settings=TraceSettings(method=method, endless_ground=switch, ray_spacing=0.15),
    )


KINDS = {
    "parts": {},
    "kerbs": {"steps": 0.3},
    "slabs": {"slabs": True},
}


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("seed", [1, 2])
def test_ground_in_parts_and_slabs_goes_on_as_drawn_wide_ground(kind: str, seed: int) -> None:
    """Adjoining meshes of drawn materials, heights and cuts, against rectangles that reach 600 m out, along the rim.

    Not at the ends of the lines between parts, which bound tubes, and not at the block: lattices turn with the scene's
    edges, so that these differ by their sampling error.
    """
    own, wide = in_parts(np.random.default_rng(seed), HALF, 600.0, **KINDS[kind])
    goes_on, reference, ends = (
        image_of(seen(meshes, np.random.default_rng(seed), switch, "image"))
        for meshes, switch in ((own, "auto"), (wide, "off"), (own, "off"))
    )
    xy = reference.grid.positions()[..., :2]
    corners = np.concatenate([np.asarray(mesh.vertices)[:, :2] for mesh in own])
    meet = corners[np.abs(corners).min(axis=1) < HALF - 1e-6]
    away = np.linalg.norm(xy[..., None, :] - meet, axis=-1).min(axis=-1) > 7.0
    away &= np.linalg.norm(xy - np.array([-22.0, 3.0]), axis=-1) > 14.0
    rim = away & (np.abs(HALF - np.abs(xy).max(axis=-1)) < 4.0)
    assert rim.sum() > 300
    left, echo = (np.square(np.abs(x.data[0] - reference.data[0])[rim]).sum() for x in (goes_on, ends))
    # tol: side lobes of the lines between parts, by their sampling error; of the rim's own echo less than a hundredth
    assert 0.0 < echo and left < 0.01 * echo


@pytest.mark.parametrize("seed", range(6))
def test_outline_of_drawn_parts_is_that_of_the_square(seed: int) -> None:
    """Area, corners, and the material of each part at the rim, turned by a drawn angle."""
    rng = np.random.default_rng(seed)
    own, _ = in_parts(rng, HALF, 600.0, steps=0.2 * (seed % 2), slabs=seed % 3 == 0)
    angle = float(rng.uniform(0.0, 2.0 * np.pi))
    turn = np.array(
        [[np.cos(angle), -np.sin(angle), 0.0], [np.sin(angle), np.cos(angle), 0.0], [0.0, 0.0, 1.0]]
    )
    turned = [replace(mesh, vertices=np.asarray(mesh.vertices) @ turn.T) for mesh in own]
    scene = seen(turned, rng)
    rim = outline(scene.geometry)
    assert not isinstance(rim, str)
    assert rim.area == pytest.approx(4.0 * HALF**2, rel=1e-6)  # tol: float32 corners
    assert rim.slab == (seed % 3 == 0)
    middle = 0.5 * (rim.points + rim.ends) @ turn
    for place, face in zip(middle, rim.face, strict=True):
        part = own[int(scene.geometry.face_mesh[face])]
        low, high = np.asarray(part.vertices).min(axis=0), np.asarray(part.vertices).max(axis=0)
        assert (place[:2] > low[:2] - 1e-4).all() and (place[:2] < high[:2] + 1e-4).all()
        assert place[2] == pytest.approx(high[2], abs=1e-4)  # the top of a slab


def test_a_rim_that_is_not_level_is_said_to_echo() -> None:
    """Terrain, also with a map of its material; not beyond the rays, nor where it is too rough to echo."""
    x = np.linspace(-HALF, HALF, 13)
    y_all, x_all = np.meshgrid(x, x)
    v = np.stack([x_all, y_all, np.sin(x_all / 9.0) * np.cos(y_all / 11.0)], axis=-1).reshape(-1, 3)
    first = (13 * np.arange(12)[:, None] + np.arange(12)).ravel()
    f = np.stack([first, first + 13, first + 14, first, first + 14, first + 1], axis=1).reshape(-1, 3)

    def notes(mesh: SceneMesh, switch: Switch = "auto") -> list[str]:
        scene = continue_ground(seen([mesh], np.random.default_rng(1), switch))
        assert continue_ground(scene) is scene
        return [note for note in scene.notes if "the echo of this edge is in the image" in note]

    hill = SceneMesh(v, f, "asphalt", "hill")
    said = notes(hill)
    assert len(said) == 1 and '"hill" is not level' in said[0] and "extend it to" in said[0]
    assert not notes(hill, "off")
    assert not notes(replace(hill, vertices=v * np.array([20.0, 20.0, 1.0])))
    assert not notes(replace(hill, material={"material": "soil", "rms_height": 0.1}))


def test_methods_raw_and_raster_know_it() -> None:
    """Raw data as hybrid; raster, without a coherent return, is the same to the bit."""
    raw = {
        half: image_of(scene_with(half, "auto", method="raw", heading=17.0, resolution=4.0))
        for half in (10.0 * HALF, HALF)
    }
    assert change_db(raw[HALF], raw[300.0], 4.0) < -23.0  # tol: as above, of cells four times as long
    raster = [image_of(scene_with(HALF, switch, method="raster")).data for switch in ("auto", "off")]
    np.testing.assert_array_equal(*raster)


ACQUISITIONS: dict[str, tuple[Method, dict[str, object]]] = {
    "stripmap": ("hybrid", {}),
    "stripmap raw": ("raw", {}),
    "spotlight squinted": ("hybrid", {"mode": "spotlight", "squint_angle_deg": 12.0}),
    "quad": ("hybrid", {"polarisation": "HH,HV,VH,VV"}),
    "image": ("image", {}),
}


@pytest.mark.parametrize("name", ACQUISITIONS)
def test_the_interior_differs_by_side_lobes_of_the_clutter_outside_alone(name: str) -> None:
    """A patch that goes on, plus the image of clutter outside it alone, is the image of ground ten times as wide.

    At cells of 4 m the interior differs from that of the wide ground by -25 dB. Two causes, both of the wide ground:
    its clutter outside has side lobes inside, and the automatic number of pulses is that of the larger scene (77, not
    74). With pulses that are given, the first is all.
    """
    method, given = ACQUISITIONS[name]
    v, f = square(HALF)
    outer = np.concatenate([v, square(10.0 * HALF)[0]])
    frame = np.array(
        [[i, 4 + i, 4 + (i + 1) % 4] for i in range(4)]
        + [[i, 4 + (i + 1) % 4, (i + 1) % 4] for i in range(4)]
    )

    def image(inside: MaterialLike, outside: MaterialLike | None, switch: Switch) -> SarImage:
        meshes = [SceneMesh(v, f, inside, "ground")]
        if outside is not None:
            meshes.append(SceneMesh(outer, frame, outside, "frame"))
        radar = {
            "slant_range": 5000.0,
            "look_angle_deg": 40.0,
            "heading_deg": 17.0,
            "aim_x": 0.0,
            "aim_y": 0.0,
        }
        radar |= {
            "center_frequency": L_BAND,
            "bandwidth": 150e6,
            "prf": 54.0,
            "n_pulses": 77,
            "aim_z": 0.0,
            **given,
        }
        film = replace(NARROW, pixel_spacing_azimuth=2.0, pixel_spacing_range=0.75)
        settings = TraceSettings(method=method, endless_ground=switch)
        return image_of(build_scene(meshes, radar=RadarDescription(**radar), film=film, settings=settings))  # type: ignore[arg-type]

    asphalt = continue_ground(scene_with(HALF, "auto")).materials
    silent = asphalt[-1]  # the same without clutter
    goes_on, wide = image("asphalt", None, "auto"), image("asphalt", "asphalt", "off")
    outside = image(silent, "asphalt", "off")
    assert (
        change_db(replace(goes_on, data=goes_on.data + outside.data), wide, -np.inf) < -100.0
    )  # tol: float32 images
    assert -40.0 < change_db(goes_on, wide, 4.0) < -20.0


def test_ground_continues_without_clutter_and_says_so_once() -> None:
    scene = scene_with(HALF, "auto")
    grown = continue_ground(scene)
    added = sorted(set(grown.geometry.face_material[scene.geometry.n_faces :].tolist()))
    assert [grown.materials[i].diffuse_law for i in added] == ["none"]
    own = scene.materials[int(scene.geometry.face_material[0])]
    assert [grown.materials[i].permittivity for i in added] == [own.permittivity]
    said = [note for note in grown.notes if "endless_ground = off" in note]
    assert len(said) == 1 and '"ground" at z = 0 m, without clutter' in said[0]
    assert continue_ground(grown) is grown  # it reaches beyond all rays


@pytest.mark.parametrize("corners", [3, 5, 16])
def test_polygons_grow_to_beyond_the_rays(corners: int) -> None:
    scene = scene_with(HALF, "auto", corners=corners, heading=40.0)
    rim = level_rim(continue_ground(scene).geometry)
    assert rim is not None and len(rim.points) == corners
    half = 0.5 * np.hypot(scene.image.extent_azimuth, scene.image.extent_range)
    assert rim.distances(np.array([scene.image.center_x, scene.image.center_y])).min() > 1.2 * half


def grows(scene: Scene) -> bool:
    return continue_ground(scene).geometry is not scene.geometry


def test_what_is_no_ground_ends_where_it_ends() -> None:

    assert grows(scene_with(HALF, "auto")) and not grows(scene_with(HALF, "off"))
    small = scene_with(4.0, "auto")
    lone_metal = scene_with(HALF, "auto", material="pec")
    rough = scene_with(HALF, "auto", material="soil", frequency=X_BAND)
    for scene in (small, lone_metal):
        assert not grows(scene)
        assert grows(replace(scene, settings=replace(scene.settings, endless_ground="on")))
    assert not grows(rough)
    assert grows(scene_with(HALF, "auto", material="pec", box=(0.0, 0.0)))
    # a wall on the rim, a shape beyond it, a pit below it, and ground that moves
    ground = SceneMesh(*square(HALF), "asphalt", "ground")
    v = np.array([[-30.0, -30, 0], [30, -30, 0], [30, -30, 5], [-30, -30, 5]])
    f = np.array([[0, 1, 2], [0, 2, 3]])
    sunk = trimesh.creation.box(extents=(HALF, 2.0 * HALF, 6.0))
    sunk.apply_translation([1.5 * HALF, 0.0, 0.0])
    moving = replace(ground, motion=Motion(velocity=(0.0, 1.0, 0.0)))
    for why, *meshes in (
        ("has a wall or", ground, SceneMesh(v, f, "concrete")),
        ("does not surround", ground, SceneMesh(v + np.array([0.0, -9.0, 1.0]), f, "concrete")),
        # a quay beside water, which is level itself: the note blamed its level
        ("does not surround", ground, SceneMesh.of(sunk, "concrete", "quay")),
        ("above the lowest shape", ground, SceneMesh(v + np.array([0.0, 9.0, -4.0]), f, "concrete")),
        ("", moving),
    ):
        scene = continue_ground(
            build_scene(meshes, radar=RadarDescription(center_frequency=L_BAND), film=NARROW)
        )
        assert not grows(scene)
        said = [note for note in scene.notes if "the echo of this edge is in the image" in note]
        assert len(said) == bool(why) and all(why in note and "\n" not in note for note in said)


GROUND = """<scene version="3.0.0"><integrator type="sar_path"/>
<sensor type="sar_antenna"><float name="slant_range" value="5000"/><float name="heading_deg" value="17"/>
<float name="bandwidth" value="150e6"/><float name="azimuth_resolution" value="1"/>
<float name="aim_x" value="0"/><float name="aim_y" value="0"/><float name="aim_z" value="0"/>
<film type="range_film"><float name="image_extent_azimuth" value="60"/>
<float name="image_extent_range" value="60"/></film>
</sensor>
<shape type="cube" id="block"><transform name="to_world"><scale x="3" y="4" z="2"/><translate z="2"/></transform>
<bsdf type="radar_material"><string name="material" value="concrete"/></bsdf></shape>
%s</scene>"""
WIDE = """<shape type="rectangle"><transform name="to_world"><scale x="300" y="300"/></transform>
<bsdf type="radar_material"><string name="material" value="soil"/></bsdf></shape>"""


def written(folder: Path, more: str) -> Path:
    path = folder / "block.xml"
    path.write_text(GROUND % more)
    return path


def test_ground_asked_for_is_that_of_a_wide_rectangle(tmp_path: Path) -> None:
    """By the shape and by ``ground``: the same pixels as a rectangle of 600 m; the image stays that of the block."""
    alone = load_scene(written(tmp_path, ""))
    wide = render(load_scene(written(tmp_path, WIDE)))
    shape = load_scene(
        written(tmp_path, '<shape type="radar_ground"><string name="material" value="soil"/></shape>')
    )
    option = load_scene(written(tmp_path, ""), ground="soil")
    assert shape.image == option.image == alone.image
    assert shape.replace(look_angle_deg=30.0).image == alone.replace(look_angle_deg=30.0).image
    for scene in (shape, option):
        # tol: rounding of float32 positions of ground of another size
        assert change_db(render(scene), wide, -np.inf) < -60.0


def test_ground_at_a_level_of_an_extent(tmp_path: Path) -> None:
    numbers = '<float name="level" value="-1.5"/><float name="extent" value="40"/>'
    bsdf = '<bsdf type="radar_material"><string name="material" value="grass"/></bsdf>'
    scene = load_scene(written(tmp_path, f'<shape type="radar_ground" id="lawn">{numbers}{bsdf}</shape>'))
    low, high = scene.geometry.bounds
    assert low.tolist() == [-20.0, -20.0, -1.5] and high[:2].tolist() == [20.0, 20.0]


@pytest.mark.parametrize(
    ("inside", "said"),
    [
        ("", "one of a bsdf and"),
        ('<string name="material" value="soil"/><float name="level" value="nan"/>', "level"),
        ('<string name="material" value="soil"/><float name="extent" value="-3"/>', "extent = -3"),
        ('<float name="material" value="3"/>', "is not a name"),
        ('<string name="material" value="sooil"/>', "sooil"),
        ('<string name="material" value="soil"/><float name="size" value="3"/>', 'unknown parameter "size"'),
    ],
)
def test_wrong_ground_is_refused_in_one_line(tmp_path: Path, inside: str, said: str) -> None:
    with pytest.raises(SceneError) as caught:
        load_scene(written(tmp_path, f'<shape type="radar_ground">{inside}</shape>'))
    assert said in str(caught.value) and "\n" not in str(caught.value)


def test_second_ground_and_a_cross_section_are_refused(tmp_path: Path) -> None:
    with pytest.raises(SceneError, match="is ground at z = 0 m already"):
        load_scene(written(tmp_path, WIDE), ground="soil")
    scene = load_scene(written(tmp_path, ""), ground="soil")
    with pytest.raises(RadarError, match="ground without end"):
        rcs_sweep(scene, Aspects(np.zeros(1), np.full(1, 0.5)))


def test_ground_on_the_command_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = written(tmp_path, "")
    assert cli.main(["explain", str(path), "--plan-only", "--ground", "asphalt"]) == 0
    said = capsys.readouterr().out
    assert "asphalt has its typical surface" in said and "laid at z = 0 m" in said
