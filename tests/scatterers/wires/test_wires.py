"""Rods: bistatic dyads, cutting, near antennas, what the mesh hides and mirrors, dots in an image."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from sarmitsuba import RadarDescription, Scene, SceneError, SceneMesh, build_scene, load_scene, simulate
from sarmitsuba.core.arrays import C128, F64
from sarmitsuba.core.errors import RadarError
from sarmitsuba.machine.backend import dr, ensure_backend, mi
from sarmitsuba.radar.film import FilmDescription
from sarmitsuba.simulation.execution.path_table import KINDS, trace_paths
from sarmitsuba.simulation.execution.turntable import Aspects, rcs_sweep
from sarmitsuba.tracing.kernel.leg import Leg
from sarmitsuba.tracing.kernel.state import Kernel
from sarmitsuba.tracing.scatterers.wires import source
from sarmitsuba.tracing.scatterers.wires.cylinder import cylinder_table
from sarmitsuba.tracing.scatterers.wires.kind import WireTarget
from sarmitsuba.tracing.scatterers.wires.source import WireScatterers, cut_wires
from sarmitsuba.truth import theory
from sarmitsuba.truth.validation.cases.wires import draw_beside_broadside, drawn_rod
from tests.support.unweighted import render

WAVELENGTH = 0.031
GROUND = np.array([[-15.0, -15.0, 0.0], [15.0, -15.0, 0.0], [15.0, 15.0, 0.0], [-15.0, 15.0, 0.0]])
FACES = [[0, 1, 2], [0, 2, 3]]
ROUGH = {"diffuse_law": "lambert", "diffuse_level_db": -10.0, "rms_height": 0.005}
# few pulses
COARSE = {"azimuth_resolution": 4.0, "bandwidth": 75e6}


class Dyad(WireScatterers):
    """Amplitudes for any two directions and real field vectors, in NumPy."""

    def of(self, incident: F64, scattered: F64, e: C128, q: C128) -> complex:
        wavenumber = 2.0 * np.pi / WAVELENGTH
        kernel = cast("Kernel", SimpleNamespace(constants=SimpleNamespace(wavenumber=mi.Float(wavenumber))))
        index = dr.arange(mi.UInt32, self.n)
        value = self.amplitude(kernel, index, sight(-incident), sight(scattered), vector(e), vector(q))
        nearer = np.array(self.nearer(index, sight(-incident), sight(scattered)), dtype=np.float64)
        phase = wavenumber * ((incident - scattered) @ np.array(self.point(index)) - 2.0 * nearer)
        return complex(np.sum((np.array(value.real) + 1j * np.array(value.imag)) * np.exp(-1j * phase)))


def vector(v: C128) -> tuple[mi.Vector3f, mi.Vector3f]:
    return mi.Vector3f(*v.real.tolist()), mi.Vector3f(*v.imag.tolist())


def sight(to: F64) -> Leg:
    return cast("Leg", SimpleNamespace(to_antenna=mi.Vector3f(*to.tolist())))


def unit(rng: np.random.Generator) -> F64:
    v = rng.normal(size=3)
    return v / np.linalg.norm(v)


@pytest.mark.parametrize("seed", range(6))
def test_between_any_two_directions_it_is_the_closed_form(seed: int) -> None:
    """On the cone and off it, conductors and dielectrics, with the turn of polarisation that tilted ones have."""
    ensure_backend()
    rng = np.random.default_rng([17, seed])
    permittivity = (None, 3.0 - 0.4j, 5.24 - 0.5j)[seed % 3]
    radius = WAVELENGTH * 10.0 ** rng.uniform(-2.5, -0.3)
    axis, middle = unit(rng), rng.uniform(-1.0, 1.0, 3)
    incident = unit(rng)
    scattered = incident - 2.0 * (incident @ axis) * axis if seed < 2 else unit(rng)
    if seed < 2:  # on the cone, another way round the axis
        flat = np.cross(axis, unit(rng))
        flat /= np.linalg.norm(flat)
        scattered = flat * np.linalg.norm(np.cross(axis, incident)) + axis * (incident @ axis)
    line = WireTarget("rod", middle - 0.2 * axis, middle + 0.2 * axis, radius, permittivity)
    e, q = (rng.normal(size=3) + 1j * rng.normal(size=3) for _ in range(2))
    wanted = theory.line_amplitude(radius, line.ends, WAVELENGTH, incident, scattered, permittivity)
    scale = np.abs(wanted).max() * np.linalg.norm(e) * np.linalg.norm(q)
    for longest in (np.inf, 0.03):
        got = Dyad(cut_wires([line], longest), [line], WAVELENGTH).of(incident, scattered, e, q)
        assert (
            abs(got - q @ wanted @ e) < 4e-3 * scale
        )  # tol: tables, float32 phases of 40 wavelengths in nodes


@pytest.mark.parametrize(
    ("ka", "permittivity"), [(1e-4, None), (3.0, None), (40.0, None), (10.0, 2.5 - 0.05j)]
)
def test_the_tables_are_fine_enough(ka: float, permittivity: complex | None) -> None:
    """Halfway between nodes of tilt, where linear interpolation errs most, at drawn azimuths."""
    table = cylinder_table(ka, permittivity)
    rng = np.random.default_rng(3)
    step = 0.5 * np.pi / (table.n_tilts - 1)
    for row in rng.integers(0, table.n_tilts // 2, 4):
        tilt, column = (row + 0.5) * step, int(rng.integers(table.n_azimuths))
        azimuth = column * np.pi / (table.n_azimuths - 1)
        phase = np.exp(2j * ka * np.cos(tilt) * np.sin(0.5 * azimuth))
        parts = 0.5 * (table.values[row, column + 1] + table.values[row + 1, column + 1])
        exact = theory.cylinder_series(ka, tilt, azimuth, permittivity)
        largest = max(
            abs(v) for v in theory.cylinder_series(ka, tilt, np.array([0.0, np.pi]), permittivity)[0]
        )
        for i in range(2):
            got = complex(parts[2 * i], parts[2 * i + 1]) * phase
            assert abs(got - complex(exact[i])) < 3e-3 * largest  # tol: 0.03 dB


def test_closed_forms_agree_with_each_other() -> None:
    """Energy of a lossless rod, a metal as a conductor, the thin dielectric needle, reciprocity."""
    azimuth = np.linspace(0.0, 2.0 * np.pi, 128, endpoint=False)
    for permittivity, tilt in ((None, 0.3), (2.5, 0.0), (2.5, 0.7)):
        mm, ee, me = theory.cylinder_series(2.0, tilt, azimuth, permittivity)
        for own in (mm, ee):  # optical theorem of the series
            assert np.mean(np.abs(own) ** 2 + np.abs(me) ** 2) == pytest.approx(own[0].real, rel=1e-9)
    metal = theory.cylinder_series(2.0, 0.4, azimuth, 1.0 - 1e10j)
    perfect = theory.cylinder_series(2.0, 0.4, azimuth)
    for a, b in zip(metal, perfect, strict=True):
        assert np.abs(a - b).max() < 1e-4  # tol: surface impedance, 1e-5
    needle = theory.dielectric_needle_series(1e-3, 4.0 - 1.0j)
    for a, b in zip(theory.cylinder_series(1e-3, 0.0, np.pi, 4.0 - 1.0j)[:2], needle, strict=True):
        assert complex(a) == pytest.approx(b, rel=1e-4)
    dipoles = [abs(theory.thin_wire_moments(n, 1e-4, 1.0)[0]) ** 2 for n in np.linspace(0.45, 0.49, 9)]
    # tol: 0.86 square wavelengths of a resonant dipole (Knott, Shaeffer and Tuley), by its thickness
    assert max(dipoles) == pytest.approx(0.86, rel=0.05)
    rng = np.random.default_rng(5)
    d, s, ends = unit(rng), unit(rng), rng.normal(size=(2, 3))
    there = theory.line_amplitude(0.05, ends, 0.3, d, s, 4.0 - 0.1j)
    back = theory.line_amplitude(0.05, ends, 0.3, -s, -d, 4.0 - 0.1j)
    assert np.abs(there - back.T).max() < 1e-12


def wire_scene(*lines: WireTarget, meshes: tuple[SceneMesh, ...] = (), **radar: object) -> Scene:
    given = {
        "slant_range": 2e3,
        "look_angle_deg": 40.0,
        "bandwidth": 150e6,
        "azimuth_resolution": 1.0,
        "polarisation": "HH,VV",
        "aim_x": 0.0,
        "aim_y": 0.0,
        "aim_z": 0.0,
    }
    film = FilmDescription(image_extent_azimuth=16.0, image_extent_range=16.0, image_grid="ground")
    return build_scene(meshes, wires=lines, radar=RadarDescription(**(given | radar)), film=film)


@pytest.mark.parametrize("seed", [1, 2])
def test_any_cut_gives_the_same_lobes(seed: int) -> None:
    """Whole and in pieces of a few wavelengths, from broadside into the far sidelobes, amplitude and phase."""
    ensure_backend()
    rng = np.random.default_rng(seed)
    line = drawn_rod(rng, 1.0, None)
    directions = draw_beside_broadside(
        rng, line, np.concatenate([np.linspace(-1.0, 1.0, 5), rng.uniform(-9.0, 9.0, 4)])
    )
    scene = build_scene(wires=[line], radar=RadarDescription())
    aspects = Aspects(np.arctan2(directions[:, 1], directions[:, 0]), np.arcsin(directions[:, 2]))
    whole = rcs_sweep(scene, aspects, checked=0).result.amplitude
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(
            "sarmitsuba.tracing.scatterers.wires.source.cut_wires",
            lambda lines, longest: cut_wires(lines, 0.05),
        )
        pieces = rcs_sweep(scene, aspects, checked=0).result.amplitude
    assert np.abs(pieces - whole).max() < 1e-3 * np.abs(whole).max()  # tol: float32 sums


@pytest.mark.parametrize(("slant_range", "angle"), [(2e3, 3.0), (60.0, 3.0)])
def test_the_automatic_cut_is_fine_enough(
    monkeypatch: pytest.MonkeyPatch, slant_range: float, angle: float
) -> None:
    """Eight times as many nodes change the echoes of a glint by less than 0.05 dB, from 60 m too."""
    ensure_backend()
    heading = np.radians(angle)
    axis = np.array([np.sin(heading), np.cos(heading), 0.0])
    scene = wire_scene(WireTarget("wire", -5.0 * axis, 5.0 * axis, 0.005), slant_range=slant_range)
    automatic = simulate(scene, seed=1).data
    usual = source.longest_step
    monkeypatch.setattr(source, "longest_step", lambda *given: usual(*given) / 8.0)
    finer = simulate(scene, seed=1).data
    # tol: 0.05 dB asked for, of the strongest pulse
    assert np.abs(automatic - finer).max() < 10 ** (0.05 / 20) * np.abs(finer).max() - np.abs(finer).max()


def test_posts_of_a_railing_are_dots_at_their_feet() -> None:
    """Places, spacing and level of three posts on concrete: the dihedral of each with the ground."""
    ensure_backend()
    places = np.array([[0.0, y, 0.0] for y in (-4.0, 0.0, 4.0)])
    posts = [WireTarget("post", p, p + np.array([0.0, 0.0, 1.2]), 0.03) for p in places]
    scene = wire_scene(
        *posts, meshes=(SceneMesh(GROUND, FACES, {"material": "concrete", "smooth": True}, "ground"),)
    )
    image = render(scene, seed=1)
    look = scene.radar.track.center_position
    incidence = float(np.arccos(look[2] / np.linalg.norm(look)))
    wavelength = scene.radar.waveform.wavelength
    eps = scene.materials[0].permittivity
    wanted = theory.post_amplitude(0.03, 1.2, wavelength, incidence, eps)
    for place in places:
        row = int(np.argmin(np.abs(image.grid.azimuth - place[1])))
        column = int(np.argmin(np.abs(image.grid.range - place[0])))
        for channel, amplitude in zip(("HH", "VV"), wanted, strict=True):
            around = image.rcs(channel)[row - 4 : row + 5, column - 4 : column + 5]
            at = np.unravel_index(np.argmax(around), around.shape)
            assert np.abs(np.array(at) - 4).max() <= 1
            # tol: 0.2 dB, the pixel beside the peak and the look over the aperture
            assert 10.0 * np.log10(around.max()) == pytest.approx(20.0 * np.log10(abs(amplitude)), abs=0.2)
    # between two posts there is nothing but their sidelobes
    middle = int(np.argmin(np.abs(image.grid.azimuth - 2.0)))
    column = int(np.argmin(np.abs(image.grid.range)))
    assert image.rcs("VV")[middle, column] < 1e-2 * image.rcs("VV").max()


@pytest.mark.parametrize("most", [1, 3])
def test_the_path_table_has_every_return_of_a_pulse(most: int) -> None:
    """Straight and over the ground, as the method raw adds them up."""
    ensure_backend()
    post = WireTarget("post", np.zeros(3), np.array([0.0, 0.0, 2.0]), 0.03)
    meshes = (SceneMesh(GROUND, FACES, "pec", "ground"),) if most == 3 else ()
    scene = wire_scene(post, meshes=meshes, **COARSE).replace(method="raw")
    raw = simulate(scene, seed=3)
    pulse = scene.radar.track.n_pulses // 3
    table = trace_paths(scene, pulse, seed=3)
    rods = table[table.kind == KINDS.index("scatterer")]
    assert set(rods.order.tolist()) == set(range(1, most + 1))
    window = scene.radar.window
    r = window.start_range[pulse] + np.arange(window.n_samples) * window.sample_spacing
    spread = np.sinc((r - table.slant_range[:, None]) / scene.radar.waveform.range_cell)
    echo = (table.amplitude[:, :, None] * spread[:, None]).sum(axis=0)
    difference = np.linalg.norm(echo - raw.data[:, pulse]) / np.linalg.norm(echo)
    assert difference < 10 ** (-40 / 20)  # tol: gridding of width 4


def test_a_raster_says_that_it_has_no_wires() -> None:
    ensure_backend()
    wire = WireTarget("wire", np.array([0.0, -2.0, 1.0]), np.array([0.0, 2.0, 1.0]), 0.01)
    meshes = (SceneMesh(GROUND, FACES, {"material": "concrete", **ROUGH}, "ground"),)
    notes = render(wire_scene(wire, meshes=meshes, **COARSE), method="raster").metadata["notes"]
    assert [note for note in notes if "wires, volumes and scatterers are left out" in note]
    with pytest.raises(RadarError, match="method raster draws surfaces, and the scene has none"):
        render(wire_scene(wire, **COARSE), method="raster")


def test_wires_made_in_python_are_checked() -> None:
    with pytest.raises(SceneError, match="not two different finite points"):
        WireTarget("rod", np.zeros(3), np.zeros(3), 0.01)
    with pytest.raises(SceneError, match="radius = 0 m"):
        WireTarget("rod", np.zeros(3), np.ones(3), 0.0)
    with pytest.raises(SceneError, match="above the bound 200"):
        cylinder_table(300.0, None)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(4))
def test_heaps_of_drawn_wires_are_the_same_from_shared_and_from_every_pulse(seed: int) -> None:
    """Drawn headings, squints, distances and beams; conductors and wood, over concrete."""
    ensure_backend()
    rng = np.random.default_rng([17, 9, seed])
    lines = []
    for number in range(6):
        foot = rng.uniform([-6.0, -6.0, 0.0], [6.0, 6.0, 2.0])
        axis = unit(rng) * [1.0, 1.0, 0.0] + [0.0, 0.0, rng.uniform()]
        end, radius = (
            foot + rng.uniform(0.5, 5.0) * axis / np.linalg.norm(axis),
            10.0 ** rng.uniform(-4.0, -1.7),
        )
        lines.append(WireTarget("rod", foot, end, radius, None if number % 2 else 3.0 - 0.3j))
    beam = {"pattern": "gaussian", "antenna_length": 1.0, "elevation_beamwidth_deg": 15.0} if seed % 2 else {}
    scene = wire_scene(
        *lines,
        meshes=(SceneMesh(GROUND, FACES, {"material": "concrete", "smooth": True}, "ground"),),
        slant_range=rng.uniform(300.0, 5e3),
        look_angle_deg=rng.uniform(20.0, 60.0),
        heading_deg=rng.uniform(0.0, 360.0),
        squint_angle_deg=rng.uniform(-15.0, 15.0),
        polarisation="HH,HV,VV",
        **beam,
    )
    shared, every = (simulate(scene.replace(method=method), seed=1).data for method in ("hybrid", "raw"))
    # tol: what blocks of pulses may err by, docs/accuracy.md
    assert np.linalg.norm(shared - every) < 10 ** (-30 / 20) * np.linalg.norm(every)


@pytest.mark.slow
def test_a_cable_across_the_flight_is_dark() -> None:
    """66 dB below one along it, which glints."""
    ensure_backend()
    power = []
    for axis in ([0.0, 5.0, 0.0], [5.0, 0.0, 0.0]):
        cable = WireTarget("cable", -np.array(axis), np.array(axis), 0.01)
        power.append(np.abs(simulate(wire_scene(cable), seed=1).data).max())
    assert power[1] < 10 ** (-50 / 20) * power[0]


WALL = np.array([[-4.0, -6.0, -1.0], [-4.0, 6.0, -1.0], [-4.0, 6.0, 20.0], [-4.0, -6.0, 20.0]])


def test_a_wall_hides_wires_and_wires_hide_nothing() -> None:
    ensure_backend()
    wire = WireTarget("wire", np.array([0.0, -2.0, 1.0]), np.array([0.0, 2.0, 1.0]), 0.01)
    black = {"permittivity_real": 1.0, "diffuse_law": "lambert", "diffuse_level_db": -60.0}
    before = WireTarget("before", np.array([-6.0, -2.0, 1.0]), np.array([-6.0, 2.0, 1.0]), 1e-4)
    # in the way of the wire, and of the wall: neither sees it
    scene = wire_scene(wire, before, meshes=(SceneMesh(WALL, FACES, black, "wall"),), **COARSE)
    assert scene.radar.track.center_position[0] < -100.0
    both = simulate(scene, seed=1).data
    alone = simulate(replace(scene, scatterers=(before,)), seed=1).data
    # tol: gridding in another box
    assert np.abs(both - alone).max() < 1e-2 * np.abs(alone).max()
    with pytest.warns(UserWarning, match="visibility is switched off"):
        seen = simulate(scene.replace(visibility="off"), seed=1).data
    assert np.abs(seen).max() > 3.0 * np.abs(alone).max()


def test_switched_off_wires_leave_the_bits_of_a_scene_without(tmp_path: Path) -> None:
    ensure_backend()
    wire = WireTarget("wire", np.array([0.0, -2.0, 1.0]), np.array([0.0, 2.0, 1.0]), 0.01)
    material = {"material": "concrete", **ROUGH}
    scene = wire_scene(wire, meshes=(SceneMesh(GROUND, FACES, material, "ground"),), **COARSE)
    with pytest.warns(UserWarning, match="line_scatterers is switched off"):
        off = simulate(scene.replace(line_scatterers="off"), seed=1).data
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        dr.kernel_history_clear()
        without = simulate(replace(scene, scatterers=()), seed=1).data
        kernels = {str(kernel["hash"]) for kernel in dr.kernel_history([dr.KernelType.JIT])}
        with pytest.warns(UserWarning, match="line_scatterers is switched off"):
            again = simulate(scene.replace(line_scatterers="off"), seed=1).data
        assert {str(kernel["hash"]) for kernel in dr.kernel_history([dr.KernelType.JIT])} <= kernels
    assert np.array_equal(off, without) and np.array_equal(again, without)


XML = """<scene version="3.0.0">
  <sensor type="sar_antenna"><film type="range_film"/></sensor>
  {shapes}
</scene>"""
CYLINDER = """<shape type="cylinder"{name}><point name="p0" x="0" y="0" z="0"/><point name="p1" x="0" y="0" z="2"/>
  <float name="radius" value="0.02"/>{more}<bsdf type="radar_wire">{bsdf}</bsdf></shape>"""


def loaded(folder: Path, shapes: str) -> Scene:
    path = folder / "scene.xml"
    path.write_text(XML.format(shapes=shapes), encoding="utf-8")
    return load_scene(path)


def test_cylinders_polylines_and_instances_are_read(tmp_path: Path) -> None:
    (tmp_path / "mast.txt").write_text(
        "0 0 0 0.05\n0 0 3 0.03\n1 0 3 0.02\n\n0 1 0 0.05\n0 1 3 0.05\n", encoding="utf-8"
    )
    turned = '<transform name="to_world"><scale value="2"/><rotate y="1" angle="90"/><translate y="5"/></transform>'
    mast = '<shape type="linearcurve"><string name="filename" value="mast.txt"/><bsdf type="radar_wire"/></shape>'
    instance = (
        '<shape type="instance"><ref id="group"/>'
        '<transform name="to_world"><translate x="{x}"/></transform></shape>'
    )
    wood = '<string name="material" value="wood"/>'
    scene = loaded(
        tmp_path,
        CYLINDER.format(name="", more=turned, bsdf=wood)
        + f'<shape type="shapegroup" id="group">{mast}</shape>'
        + instance.format(x=3)
        + instance.format(x=9),
    )
    rod, *members = scene.wires
    assert np.allclose(rod.ends, [[0.0, 5.0, 0.0], [4.0, 5.0, 0.0]]) and rod.radius == pytest.approx(0.04)
    assert rod.permittivity is not None and 1.5 < rod.permittivity.real < 2.5
    assert len(members) == 6 and all(m.permittivity is None for m in members)
    assert np.allclose(members[1].ends, [[3.0, 0.0, 3.0], [4.0, 0.0, 3.0]])
    assert members[0].radius == pytest.approx(0.04)
    assert np.allclose(members[3].start - members[0].start, [6.0, 0.0, 0.0])
    assert len({line.name for line in scene.wires}) == 7


@pytest.mark.parametrize(
    ("shape", "message"),
    [
        (
            CYLINDER.format(name="", more='<transform name="to_world"><scale x="2"/></transform>', bsdf=""),
            "oval",
        ),
        (CYLINDER.format(name="", more='<string name="velocity" value="1 0 0"/>', bsdf=""), "moves"),
        (CYLINDER.replace('value="0.02"', 'value="0.6"').format(name="", more="", bsdf=""), "too thick"),
        ('<shape type="sphere"><bsdf type="radar_wire"/></shape>', "put it on a cylinder"),
        ('<shape type="linearcurve"><string name="filename" value="mast.txt"/></shape>', "no surface"),
        (
            '<shape type="linearcurve"><string name="filename" value="bad.txt"/><bsdf type="radar_wire"/></shape>',
            'row 2 of bad.txt is not "x y z radius"',
        ),
        (
            '<shape type="cylinder"><point name="p1" x="0" y="0" z="90"/><float name="radius" value="9"/>'
            '<bsdf type="radar_wire"/></shape>',
            "above the bound 200",
        ),
    ],
)
def test_what_is_no_wire_is_refused(tmp_path: Path, shape: str, message: str) -> None:
    (tmp_path / "mast.txt").write_text("0 0 0 0.05\n0 0 3 0.03\n", encoding="utf-8")
    (tmp_path / "bad.txt").write_text("0 0 0 0.05\n0 0 3\n", encoding="utf-8")
    with pytest.raises(SceneError, match=message) as caught:
        loaded(tmp_path, shape)
    assert "\n" not in str(caught.value)
