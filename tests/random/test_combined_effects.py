"""Crowns, panes, rods, edges, pairs, water, maps and points drawn into one scene: nothing forgets the others."""

import dataclasses
import pickle
import warnings
from pathlib import Path

import numpy as np
import pytest
import trimesh
from matplotlib.image import imsave

import sarmitsuba
from sarmitsuba.core.errors import SarmitsubaWarning
from sarmitsuba.effects.context import seen_through
from sarmitsuba.loading.build import SceneMesh, build_scene
from sarmitsuba.radar.description import RadarDescription
from sarmitsuba.radar.film import FilmDescription
from sarmitsuba.scene.scene import Scene
from sarmitsuba.simulation.execution.fingerprint import fingerprint
from sarmitsuba.simulation.execution.path_table import POINT
from sarmitsuba.simulation.execution.render import simulate
from sarmitsuba.simulation.execution.turntable import Aspects, rcs_sweep
from sarmitsuba.simulation.planning.pilot import plan_scene
from sarmitsuba.truth import theory
from tests.support.unweighted import focus

DB = 10.0 * np.log10(np.e)


def place(
    x: float, y: float, z: float, sx: float = 1.0, sy: float = 1.0, sz: float = 1.0, turn: str = ""
) -> str:
    return (
        f'<transform name="to_world"><scale x="{sx}" y="{sy}" z="{sz}"/>{turn}'
        f'<translate x="{x}" y="{y}" z="{z}"/></transform>'
    )


def shape(kind: str, bsdf: str, inside: str, name: str) -> str:
    return f'<shape type="{kind}" id="{name}">{inside}<ref id="{bsdf}"/></shape>'


def bsdf(kind: str, name: str, **values: object) -> str:
    return f'<bsdf type="{kind}" id="{name}">{parameters(values)}</bsdf>'


def parameters(values: dict[str, object]) -> str:
    kinds = {str: "string", int: "integer", bool: "boolean"}
    return "".join(f'<{kinds.get(type(v), "float")} name="{k}" value="{v}"/>' for k, v in values.items())


def crown(x: float, y: float, folder: Path) -> str:
    medium = bsdf("radar_volume", "leaves", preset="deciduous_summer", temporal_coherence=0.3)
    return medium + shape("sphere", "leaves", place(x, y, 3.5, 1.5, 1.5, 2.0), "crown")


def rods(x: float, y: float, folder: Path) -> str:
    (folder / "rods.txt").write_text(f"{x} {y - 2} 1 0.02\n{x} {y + 2} 1.3 0.02\n", encoding="utf-8")
    row = '<string name="filename" value="rods.txt"/>'
    return bsdf("radar_wire", "steel") + shape("linearcurve", "steel", row, "rail")


def pane(x: float, y: float, folder: Path) -> str:
    upright = place(x - 1.0, y, 1.5, 1.5, 2.0, 1.0, '<rotate y="1" angle="-90"/>')
    return (
        bsdf("radar_material", "glass", material="glass", thickness=0.006, diffuse_law="none")
        + bsdf("radar_material", "metal", material="pec")
        + shape("rectangle", "glass", upright, "pane")
        + shape("cube", "metal", place(x + 1.0, y, 0.8, 0.5, 0.6, 0.5), "box")
    )


def court(x: float, y: float, folder: Path) -> str:
    rough = {"rms_height": 0.012, "diffuse_law": "lambert", "diffuse_level_db": 1.0}
    return (
        bsdf("radar_material", "stone", material="concrete", **rough)
        + shape("cube", "stone", place(x + 1.5, y, 1.5, 0.3, 2.0, 1.5), "wall")
        + shape("rectangle", "stone", place(x - 0.6, y, 0.03, 1.5, 2.0), "floor")
    )


def water(x: float, y: float, folder: Path) -> str:
    wind = {"diffuse_law": "sea", "wind_speed": 6.0, "wind_direction_deg": 70.0, "fetch": 2000.0}
    sea = bsdf("radar_material", "sea", material="sea_water", **wind)
    return sea + shape("rectangle", "sea", place(x, y, 0.03, 3.0, 3.0), "pond")


def cover(x: float, y: float, folder: Path) -> str:
    classes = np.zeros((8, 8, 3), np.uint8)
    classes[:4, :, 0] = classes[4:, :, 1] = 255
    imsave(folder / "cover.png", classes)
    rough = {"rms_height": 0.01, "diffuse_law": "constant_gamma", "texture_shape": 1.5, "texture_length": 1.0}
    return (
        bsdf("radar_material", "gravel", material="concrete", diffuse_level_db=-6.0, **rough)
        + bsdf("radar_material", "mud", material="wet_ground", diffuse_level_db=-12.0, **rough)
        + '<bsdf type="land_cover" id="cover"><texture type="bitmap" name="class_map">'
        + '<string name="filename" value="cover.png"/></texture>'
        + f'<string name="map_extent" value="{x - 3} {y - 3} {x + 3} {y + 3}"/>'
        + '<ref name="color_ff0000" id="gravel"/><ref name="color_00ff00" id="mud"/></bsdf>'
        + shape("rectangle", "cover", place(x, y, 0.03, 3.0, 3.0), "field")
    )


def point(x: float, y: float, folder: Path) -> str:
    target = f'<point name="center" x="{x}" y="{y}" z="1"/>'
    return bsdf("point_scatterer", "ideal", rcs_dbsm=5.0) + shape("sphere", "ideal", target, "point")


FEATURES = {f.__name__: f for f in (crown, rods, pane, court, water, cover, point)}
GROUND = bsdf(
    "radar_material",
    "soil",
    material="medium_dry_ground",
    rms_height=0.004,
    diffuse_law="constant_gamma",
    diffuse_level_db=-16.0,
) + shape("rectangle", "soil", place(0.0, 0.0, 0.0, 20.0, 20.0), "ground")
FILM = {
    "image_center_x": 0.0,
    "image_center_y": 0.0,
    "image_extent_azimuth": 34.0,
    "image_extent_range": 34.0,
}


def drawn_radar(rng: np.random.Generator, **given: object) -> dict[str, object]:
    receiver = {"receiver_offset_along": float(rng.uniform(-80, 80))} if rng.random() < 0.5 else {}
    return {
        "mode": str(rng.choice(["stripmap", "spotlight", "sliding_spotlight"])),
        "slant_range": 2000.0,
        "heading_deg": float(rng.uniform(-180.0, 180.0)),
        "look_angle_deg": float(rng.uniform(30.0, 60.0)),
        "look_side": str(rng.choice(["left", "right"])),
        "center_frequency": 5.4e9,
        "bandwidth": 150e6,
        "azimuth_resolution": 1.0,
        "aim_x": 0.0,
        "aim_y": 0.0,
        "aim_z": 0.0,
        "polarisation": str(rng.choice(["HH,VV", "RH,RV"])),
        **receiver,
        **given,
    }


def loaded(folder: Path, content: str, radar: dict[str, object], **settings: object) -> Scene:
    film = f'<film type="range_film">{parameters(FILM)}</film>'
    sensor = f'<sensor type="sar_antenna">{parameters(radar)}{film}</sensor>'
    path = f'<integrator type="sar_path">{parameters(settings)}</integrator>'
    file = folder / "drawn.xml"
    file.write_text(f'<scene version="3.0.0">{path}{sensor}{content}</scene>', encoding="utf-8")
    return sarmitsuba.load_scene(file)


def drawn(folder: Path, seed: int, names: tuple[str, ...], **settings: object) -> Scene:
    rng = np.random.default_rng([17, seed])
    corners = [(x, y) for x in (-9.0, 0.0, 9.0) for y in (-9.0, 0.0, 9.0)]
    rng.shuffle(corners)
    parts = [FEATURES[name](*corner, folder) for name, corner in zip(names, corners, strict=False)]
    return loaded(folder, GROUND + "".join(parts), drawn_radar(rng), **settings)


VEIL = bsdf(
    "radar_volume", "veil", sigma_v_h_db=-100.0, extinction_h=0.1, extinction_v=0.2, scatterer_spacing=4.0
)
# a cloud of 2 m over everything, and mesh that it stands on, edge-on to no antenna and far below the point
OVER = VEIL + shape("cube", "veil", place(0.0, 0.0, 5.0, 15.0, 15.0), "cloud")
UNDER = bsdf("radar_material", "tar", rms_height=0.0, permittivity_real=1.001) + shape(
    "rectangle", "tar", place(-12.0, -12.0, -2.0, 0.1, 0.1), "tile"
)


@pytest.mark.filterwarnings("ignore:.*falls outside the receive window")
@pytest.mark.parametrize("seed", [0, *(pytest.param(s, marks=pytest.mark.slow) for s in range(1, 9))])
def test_a_cloud_before_an_ideal_point_takes_what_it_takes_from_all(tmp_path: Path, seed: int) -> None:
    rng = np.random.default_rng([1701, seed])
    given: dict[str, object] = {"mode": "spotlight", "polarisation": "HH,VV,RH", "azimuth_resolution": 2.0}
    radar = drawn_radar(rng, **given)
    content = UNDER + point(float(rng.uniform(-5, 5)), float(rng.uniform(-5, 5)), tmp_path)
    free, veiled = (loaded(tmp_path, content + over, radar, max_depth=1) for over in ("", OVER))
    legs = [track.position - veiled.points[0].position for track in veiled.radar.tracks]
    slant = [np.linalg.norm(leg, axis=1) / leg[:, 2] for leg in legs]
    way = 2.0 * float(np.mean(slant[0] + slant[-1]))
    powers = [
        # of a pulse: what lies beside the image calls for more of them
        [float((np.abs(raw.total(channel)) ** 2).sum(axis=1).mean()) for channel in raw.channels]
        for raw in map(sarmitsuba.simulate, (free, veiled))
    ]
    found = 10.0 * np.log10(np.divide(powers[1], powers[0]))
    # RH has HH's half, of which nothing turns
    want = np.array([-0.1, -0.2, -0.1]) * way * DB
    # tol: bodies are drawn smaller by some 1e-4 of their thickness; the tile and the cloud return -40 dB
    np.testing.assert_allclose(found, want, atol=0.03)
    table = [sarmitsuba.trace_paths(scene) for scene in (free, veiled)]
    points = [t.amplitude[t.kind == POINT][0] for t in table]
    kept = 20.0 * np.log10(np.abs(points[1]) / np.abs(points[0]))
    np.testing.assert_allclose(kept, want, atol=0.03)


ALL = tuple(FEATURES)


BESIDE = {
    "rod": bsdf("radar_wire", "steel")
    + '<shape type="cylinder" id="rod"><point name="p0" x="4" y="0" z="0"/><point name="p1" x="4" y="0" z="2"/>'
    + '<float name="radius" value="0.01"/><ref id="steel"/></shape>',
    "crown": bsdf("radar_volume", "leaves", preset="hedge")
    + shape("cube", "leaves", place(4.0, 0.0, 2.0), "hedge"),
    "point": bsdf("point_scatterer", "ideal") + shape("sphere", "ideal", place(4.0, 0.0, 1.0), "ideal_point"),
}
GLASS = bsdf("radar_material", "glass", material="glass", thickness=0.006, diffuse_law="none")
FRONT = GLASS + shape(
    "rectangle", "glass", place(0.0, 0.0, 1.5, 3.0, 3.0, 1.0, '<rotate y="1" angle="-90"/>'), "pane"
)


@pytest.mark.parametrize("behind", ["", *BESIDE])
def test_whatever_stands_behind_a_pane_calls_for_transmission(tmp_path: Path, behind: str) -> None:
    radar = drawn_radar(np.random.default_rng(8), heading_deg=0.0, look_side="right")
    scene = loaded(tmp_path, FRONT + BESIDE.get(behind, ""), radar)
    materials = seen_through(scene, scene.radar.track.position)
    assert [m.name for m in materials] == (["glass"] if behind else [])


def test_an_ideal_point_behind_a_pane_has_the_pane_in_its_radar_cross_section(tmp_path: Path) -> None:
    radar = drawn_radar(np.random.default_rng(8), heading_deg=0.0, look_side="right", polarisation="HH,VV")
    free, paned = (
        loaded(tmp_path, UNDER + BESIDE["point"] + front, radar, max_depth=1) for front in ("", FRONT)
    )
    aspects = Aspects(azimuth=np.radians([180.0]), elevation=np.radians([20.0]))
    away, there = (
        rcs_sweep(scene, aspects, checked=0).result.amplitude.sum(axis=1)[0] for scene in (free, paned)
    )
    only = rcs_sweep(loaded(tmp_path, UNDER + FRONT, radar, max_depth=1), aspects, checked=0)
    point = there - only.result.amplitude.sum(axis=1)[0]
    glass = next(m for m in paned.materials if m.name == "glass")
    factors = theory.slab_insertion(
        np.cos(np.radians(20.0)), glass.permittivity, 0.006, paned.radar.waveform.wavelength
    )
    # tol: float32 phases; H is TE at an upright pane, V is TM
    np.testing.assert_allclose(np.abs(point / away), np.abs(np.squeeze(factors)) ** 2, rtol=2e-3)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:.*displaces the echo")
def test_a_point_behind_a_pane_while_something_moves(tmp_path: Path) -> None:
    car = UNDER.replace('<ref id="tar"/>', '<string name="velocity" value="0.5 1 0"/><ref id="tar"/>')
    radar = drawn_radar(np.random.default_rng(8), heading_deg=0.0, look_side="right", prf=130.0)
    scene = loaded(tmp_path, car + BESIDE["point"] + FRONT, radar, max_depth=1)
    assert np.isfinite(sarmitsuba.simulate(scene).data).all()


def chosen(seed: int) -> tuple[str, ...]:
    """Three of all features."""
    return tuple(str(n) for n in np.random.default_rng([9, seed]).choice(ALL, 3, replace=False))


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(8))
def test_drawn_mixtures_by_key_pulses_are_those_of_every_pulse(tmp_path: Path, seed: int) -> None:
    scene = drawn(tmp_path, seed, chosen(seed))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", SarmitsubaWarning)
        every = dataclasses.replace(scene, settings=dataclasses.replace(scene.settings, method="raw"))
        raw, hybrid = sarmitsuba.simulate(every), sarmitsuba.simulate(scene)
    assert np.isfinite(hybrid.data).all()
    other = sarmitsuba.simulate(every, pass_index=1)
    apart, noise = (np.linalg.norm(r.data - raw.data) / np.linalg.norm(raw.data) for r in (hybrid, other))
    # tol: what other rays make of it, and -28 dB of what holds for a block of pulses
    assert apart < 1.5 * noise + 0.04, chosen(seed)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("seed", "names"),
    [
        (1, ("crown", "rods", "court", "point")),
        (2, ("rods", "crown", "point")),
        (3, ("water", "cover", "crown", "rods")),
    ],
)
def test_paths_of_a_mixture_add_up_to_its_echo(tmp_path: Path, seed: int, names: tuple[str, ...]) -> None:
    scene = drawn(tmp_path, seed, names, method="raw")
    quiet = dataclasses.replace(scene.settings, keep_subsets=False)  # the rays of the table are one set
    scene = dataclasses.replace(scene, settings=quiet)
    raw, table = sarmitsuba.simulate(scene), sarmitsuba.trace_paths(scene)
    pulse, window = scene.radar.track.center_index, raw.radar.window
    range_ = window.start_range[pulse] + np.arange(window.n_samples) * window.sample_spacing
    offset = (range_ - table.slant_range[:, None]) / raw.radar.waveform.range_cell
    echo = table.amplitude.T @ np.sinc(offset)
    # tol: -55 dB of four samples' gridding
    assert np.linalg.norm(echo - raw.data[:, pulse]) < 2e-3 * np.linalg.norm(raw.data[:, pulse])


def test_a_mixture_keeps_its_fingerprint_in_another_process(tmp_path: Path) -> None:
    scene = drawn(tmp_path, 3, ALL)
    run_hash = fingerprint(scene)
    assert fingerprint(pickle.loads(pickle.dumps(scene))) == run_hash
    assert fingerprint(drawn(tmp_path, 3, ALL)) == run_hash


def test_any_change_of_what_stands_beside_the_mesh_changes_the_fingerprint(tmp_path: Path) -> None:
    scene = drawn(tmp_path, 3, ALL)
    marks = [fingerprint(scene)]
    for name in ("scatterers", "points", "materials"):
        for i, item in enumerate(getattr(scene, name)):
            for changed in changes(item):
                items = [*getattr(scene, name)]
                items[i] = changed
                marks.append(fingerprint(dataclasses.replace(scene, **{name: tuple(items)})))
    assert len(marks) > 50
    assert len(set(marks)) == len(marks)


def changes(item: object) -> list[object]:
    """The same with one of its numbers, or of those within it, a little larger."""
    out: list[object] = []
    assert dataclasses.is_dataclass(item)
    for part in dataclasses.fields(item):
        value = getattr(item, part.name)
        if isinstance(value, np.ndarray) and value.size and value.dtype.kind in "fc":
            moved = value.copy()
            moved.reshape(-1)[-1] += 0.5
            new = [moved]
        elif isinstance(value, float) and np.isfinite(value):
            new = [value + 0.0078125]
        elif dataclasses.is_dataclass(value):
            new = changes(value)
        else:
            continue
        for one in new:
            try:
                out.append(dataclasses.replace(item, **{part.name: one}))
            except (ValueError, TypeError, sarmitsuba.SarmitsubaError):
                continue
    return out


@pytest.mark.filterwarnings("ignore:.*edge_diffraction is switched off")
@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_edges_by_way_of_the_ground_are_not_left_out(seed: int) -> None:
    """An upright edge of a metal box adds up over its whole height in the ground: the plan knows."""
    rng = np.random.default_rng(seed)
    box = trimesh.creation.box((*rng.uniform(3.0, 7.0, 2), rng.uniform(4.0, 7.0)))
    box.apply_translation([0.0, 0.0, -box.bounds[0, 2]])
    box.apply_transform(trimesh.transformations.rotation_matrix(rng.uniform(0.0, 1.5), [0.0, 0.0, 1.0]))
    ground = np.array([[-18.0, -18.0, 0.0], [18.0, -18.0, 0.0], [18.0, 18.0, 0.0], [-18.0, 18.0, 0.0]])
    soil = {
        "material": "wet_ground",
        "rms_height": 0.0022,
        "diffuse_law": "constant_gamma",
        "diffuse_level_db": rng.uniform(-22.0, -14.0),
    }
    radar = RadarDescription(
        slant_range=3e3,
        look_angle_deg=rng.uniform(40.0, 60.0),
        center_frequency=5.4e9,
        bandwidth=100e6,
        azimuth_resolution=1.4,
        polarisation="HH",
    )
    film = FilmDescription(image_extent_azimuth=26.0, image_extent_range=26.0)
    meshes = [SceneMesh(ground, [[0, 1, 2], [0, 2, 3]], soil, "ground"), SceneMesh.of(box, "pec", "box")]
    scene = build_scene(meshes, radar=radar, film=film)
    decision = plan_scene(scene).decision("edge_diffraction")
    assert decision is not None
    images = [
        focus(simulate(scene.replace(edge_diffraction=switch), seed=1)).data.sum(axis=0)
        for switch in ("on", "off")
    ]
    change = 20.0 * np.log10(np.linalg.norm(images[0] - images[1]) / np.linalg.norm(images[1]))
    assert decision.on or change < decision.error_db
    assert change > -40.0  # the scene tells
