"""The bench: its state is a scene file whose command gives the same image; its sliders, its page, its geometry."""

import dataclasses
import shlex
import socket
import urllib.error
import urllib.request
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import sarmitsuba
from sarmitsuba.apps.studio_bench import BenchState, command, first_state, save, scene_xml, surfaces, view_of
from sarmitsuba.apps.studio_scene import beam_at, bodies, image_plane, track_shown
from sarmitsuba.cli import main
from sarmitsuba.core.errors import SarmitsubaError, SceneError
from sarmitsuba.files import read_image
from sarmitsuba.signal.image import ImageGrid
from tests.support.draws import few_of


def drawn_state(seed: int) -> BenchState:
    """Sliders somewhere, on a small scene."""
    rng = np.random.default_rng(seed)
    return dataclasses.replace(
        first_state("tower"),
        look_angle_deg=float(rng.uniform(25, 55)),
        heading_deg=float(rng.uniform(-180, 180)),
        look_side=str(rng.choice(["left", "right"])),
        mode=str(rng.choice(["stripmap", "spotlight"])),
        frequency=float(rng.choice([1.2575e9, 5.405e9, 9.65e9])),
        resolution=float(rng.uniform(1.5, 3.0)),
        polarisation=str(rng.choice(["HH", "VV"])),
        max_depth=int(rng.integers(0, 4)),
        size=float(rng.uniform(0.4, 0.9)),
        materials={"concrete": str(rng.choice(["pec", "wood", "glass"])), "soil": "wet_ground"},
    )


@pytest.mark.filterwarnings("ignore:.*leaves out returns")  # of the bounces that were drawn
@pytest.mark.parametrize("seed", few_of([1, 2, 3]))
def test_saved_command_makes_the_same_image_to_the_bit(seed: int, tmp_path: Path) -> None:
    state = drawn_state(seed)
    view = view_of(state, tmp_path)
    path = save(state, tmp_path / "kept here")
    assert path.name == "bench_1.xml" and save(state, tmp_path / "kept here").name == "bench_2.xml"
    words = shlex.split(command(path))
    assert words[:3] == ["python", "-m", "sarmitsuba"]
    assert main([*words[3:], "--quiet"]) == 0
    again = read_image(tmp_path / "kept here" / "bench_1" / "image.h5")
    assert view.image.data.any() and again.layers == view.image.layers
    assert np.array_equal(again.data, view.image.data)
    assert np.array_equal(again.grid.azimuth, view.image.grid.azimuth)


@pytest.mark.filterwarnings("ignore:.*has no radar parameters")
def test_first_state_is_what_the_scene_says(tmp_path: Path) -> None:
    state, scene = first_state("dihedral"), sarmitsuba.load_scene("dihedral")
    assert (state.look_angle_deg, state.heading_deg, state.slant_range) == (45.0, 0.0, 10000.0)
    assert state.frequency == scene.radar.waveform.center_frequency and state.polarisation == "HH"
    view = view_of(state, tmp_path)
    # the double bounce, 8 pi a^2 b^2 / lambda^2 less the automatic rays' error
    assert view.rcs.dbsm("HH")[0] == pytest.approx(44.157, abs=0.1)
    assert np.array_equal(view.scene.geometry.vertices, scene.geometry.vertices)
    bare = tmp_path / "bare.xml"
    bare.write_text(
        '<scene version="3.0.0"><shape type="cube"><bsdf type="diffuse"/></shape><sensor type="perspective"/></scene>'
    )
    assert first_state(str(bare)).frequency == 9.65e9  # no radar of its own: a shipped one's


GROUND = """<scene version="3.0.0"><bsdf type="radar_material" id="yard"><string name="material" value="gravel"/></bsdf>
<bsdf type="radar_material" id="wall"><string name="material" value="brick"/></bsdf>
<shape type="radar_ground"><ref id="yard"/><float name="level" value="-0.5"/></shape>
<shape type="cube"><transform name="to_world"><scale value="3"/><translate z="2.5"/></transform><ref id="wall"/></shape>
</scene>"""


def test_a_scene_on_ground_without_end_is_simulated(tmp_path: Path) -> None:
    """It has an image and no cross section, for which the whole scene was refused."""
    pytest.importorskip("viser", reason="the page of the bench; in the studio extra")
    from sarmitsuba.apps.studio import rcs_text

    (tmp_path / "yard.xml").write_text(GROUND)
    state = dataclasses.replace(first_state(str(tmp_path / "yard.xml")), size=2.0)
    view = view_of(state, tmp_path)
    assert view.rcs is None and "no RCS" in rcs_text(view)
    sigma0 = view.image.to_db()
    # gravel around the wall, typical level of the X band; tol: speckle's median lies 1.6 dB below its mean
    assert np.median(sigma0[:10]) == pytest.approx(-17.6, abs=1.0)
    low, high = view.scene.geometry.bounds + view.scene.offset
    assert (low[2], high[2]) == pytest.approx((-1.0, 11.0))


def test_size_and_material_change_what_they_say(tmp_path: Path) -> None:
    plain = first_state("tower")
    state = dataclasses.replace(plain, size=2.5, materials={"gravel": "metal"})
    paths = []
    for i, one in enumerate((plain, state)):
        paths.append(tmp_path / f"{i}.xml")
        paths[-1].write_text(scene_xml(one))
    small, large = (sarmitsuba.load_scene(path) for path in paths)
    assert np.allclose(large.geometry.vertices, 2.5 * small.geometry.vertices, rtol=1e-12, atol=1e-12)
    before, after = ({m.name: m for m in scene.materials} for scene in (small, large))
    assert after["gravel"].rms_height == before["gravel"].rms_height == 0.01
    assert after["gravel"].diffuse_law == before["gravel"].diffuse_law
    assert abs(after["gravel"].permittivity) > 1e5 > abs(before["gravel"].permittivity)
    assert after["soil"] == before["soil"]
    assert surfaces(plain.source) == ("soil", "concrete", "gravel")


def test_what_the_bench_cannot_take_is_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SceneError, match="has no bsdf"):
        scene_xml(dataclasses.replace(first_state("tower"), materials={"roof": "pec"}))
    (tmp_path / "box.ply").write_text("ply\n")
    with pytest.raises(SceneError, match="the studio needs a scene file"):
        first_state(str(tmp_path / "box.ply"))
    (tmp_path / "torn.xml").write_text("<scene>")
    with pytest.raises(SceneError, match="not well-formed"):
        first_state(str(tmp_path / "torn.xml"))
    assert main(["studio", "tower", "--port", "0", "-o", str(tmp_path / "out")]) == 2
    assert "--port 0 is not from 1 to 65535" in capsys.readouterr().err and not (tmp_path / "out").exists()


@pytest.mark.parametrize("side", ["left", "right"])
def test_beam_follows_the_mode_and_directions_stay_true(side: str, tmp_path: Path) -> None:
    for mode in ("spotlight", "stripmap"):
        state = dataclasses.replace(first_state("tower"), mode=mode, look_side=side, heading_deg=70.0)
        (tmp_path / "scene.xml").write_text(scene_xml(state))
        scene = sarmitsuba.load_scene(tmp_path / "scene.xml")
        first, middle, last = (beam_at(scene, share) for share in (0.0, 0.5, 1.0))
        radar = scene.radar
        for share, beam in ((0.0, first), (1.0, last)):
            true = radar.track.position[round(share * (radar.track.n_pulses - 1))] - radar.aim_point
            near = beam.antenna - radar.aim_point
            assert np.allclose(near / np.linalg.norm(near), true / np.linalg.norm(true), atol=1e-12)
        moved = last.middle - first.middle
        if mode == "spotlight":
            assert np.abs(moved).max() < 1e-6
        else:
            assert np.allclose(moved, last.antenna - first.antenna, atol=1e-6)
            assert np.linalg.norm(moved) > 1.0
        # the rim is as wide as the image, about its centre
        center = np.array([scene.image.center_x, scene.image.center_y, scene.image.height])
        assert np.allclose(middle.rim.mean(axis=0), center, atol=0.5)
        span = np.ptp(middle.rim @ np.stack([radar.track.along, radar.across], axis=1), axis=0)
        assert np.allclose(span, [scene.image.extent_azimuth, scene.image.extent_range], rtol=1e-6)
        assert track_shown(scene).shape == radar.track.position.shape
        assert sum(len(body.faces) for body in bodies(scene)) == scene.geometry.n_faces


@pytest.mark.parametrize("left", [False, True])
def test_image_lies_where_its_pixels_are(left: bool) -> None:
    angle = 0.7
    along = np.array([np.sin(angle), np.cos(angle), 0.0])
    across = np.array([along[1], -along[0], 0.0]) * (-1.0 if left else 1.0)
    grid = ImageGrid(
        "ground",
        np.arange(-3.0, 4.0),
        np.arange(-10.0, 11.0, 2.0),
        np.array([5.0, 6.0, 2.0]),
        along,
        across,
        2.0,
    )
    image = sarmitsuba.SarImage(
        np.zeros((1, *grid.shape), dtype=np.complex64), (), grid, 0.03, 1.0, 1.0, np.full(grid.shape[1], 0.7)
    )
    grey = np.random.default_rng(0).integers(0, 255, grid.shape).astype(np.uint8)
    plane = image_plane(image, grey, 0.0)
    rows, columns = grey.shape
    for row, column in ((0, 0), (2, 7), (6, 10)):
        place = grid.positions_on_line(row)[column] - plane.center
        right = int(np.floor((place @ plane.right / plane.width + 0.5) * columns))
        down = int(np.floor((0.5 - place @ plane.up / plane.height) * rows))
        assert plane.colours[down, right, 0] == grey[row, column]
    assert np.cross(plane.right, plane.up)[2] > 0.99  # seen from above


def test_page_is_served_here_only_and_its_sliders_simulate(tmp_path: Path) -> None:
    pytest.importorskip("viser", reason="the page of the bench; in the studio extra")
    from sarmitsuba.apps.studio import Studio

    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    studio = Studio("plate", tmp_path, port=port)
    try:
        assert studio.address.startswith(f"http://127.0.0.1:{port}/?token=")
        assert_guarded(studio.address)
        studio.step()
        assert studio.view is not None and studio.view.state.look_angle_deg == studio.state.look_angle_deg
        before = studio.view
        asked = {"look_angle_deg": 30.0, "mode": "spotlight", "size": 2.0, "max_depth": 2}
        assert studio.controls["max_depth"].value == "automatic"
        for name, value in asked.items():
            studio.controls[name].value = str(value) if name == "max_depth" else value
        turns = iter(range(400))  # callbacks of the page run in threads of their own
        studio.serve(lambda: next(turns, None) is None or _has(studio, asked), patience=0.05)
        assert _has(studio, asked)
        assert studio.view.image.grid.shape != before.image.grid.shape
        studio.save()
        assert studio.saved is not None and studio.saved.name == "plate_1.xml"
        assert studio.saved.read_text() == scene_xml(studio.view.state)
        studio.controls["frequency"].value = next(
            o for o in studio.controls["frequency"].options if o.startswith("C,")
        )
        turns = iter(range(400))
        studio.serve(lambda: next(turns, None) is None or _has(studio, {"frequency": 5.405e9}), patience=0.05)
        assert _has(studio, {"frequency": 5.405e9})
    finally:
        studio.close()


def test_an_image_out_of_date_is_pale(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """While the next one is simulated, and after a state that cannot be; with the same content."""
    pytest.importorskip("viser")
    from sarmitsuba.apps import studio as server

    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        studio = server.Studio("plate", tmp_path, port=free.getsockname()[1] + 1)
    try:
        studio.step()
        sharp = studio._picture.image.astype(float)
        seen = []

        def looked(*_: object) -> None:
            seen.append(studio._picture.image.astype(float))
            raise SceneError("not this one")

        monkeypatch.setattr(server, "view_of", looked)
        studio.step()
        studio.step()
        for pale in (*seen, studio._picture.image.astype(float)):
            assert np.ptp(pale) == pytest.approx(0.35 * np.ptp(sharp), abs=1.0)  # tol: whole grey levels
            assert np.corrcoef(pale.ravel(), sharp.ravel())[0, 1] > 0.999
        assert "not simulated" in studio._status.content
        monkeypatch.undo()
        studio.step()
        assert np.array_equal(studio._picture.image, sharp)
    finally:
        studio.close()


def assert_guarded(address: str) -> None:
    """The page opens by its address, then by the cookie; not without, by another name, or from other pages."""
    bare, _, token = address.partition("?token=")
    cookie = {"Cookie": f"sarmitsuba_studio={token}"}
    socket_of = {"Upgrade": "websocket", "Connection": "Upgrade", "Sec-WebSocket-Version": "13"}
    socket_of["Sec-WebSocket-Key"] = "AAAAAAAAAAAAAAAAAAAAAA=="

    def status(url: str, headers: dict[str, str]) -> int:
        try:
            with urllib.request.urlopen(urllib.request.Request(url, headers=headers)) as found:
                assert b"<html" in found.read().lower()
                return int(found.status)
        except urllib.error.HTTPError as error:
            return error.code

    assert status(address, {}) == 200 and status(bare, cookie) == 200
    own = bare.rstrip("/")
    assert status(bare, cookie | {"Origin": own}) == 200
    for headers in (
        {},
        {"Cookie": "sarmitsuba_studio=x"},
        cookie | {"Host": "evil.example"},
        cookie | {"Host": "[::1"},
        cookie | {"Origin": "http://[::1"},
        cookie | {"Origin": "http://evil.example"},
        cookie | {"Origin": "null"},
        cookie | socket_of | {"Origin": "http://127.0.0.1:1"},
        socket_of | {"Origin": own},
    ):
        assert status(bare, headers) == 403, headers


def test_the_page_is_for_this_machine_alone(tmp_path: Path) -> None:
    pytest.importorskip("viser")
    from sarmitsuba.apps.studio import Studio

    with pytest.raises(SarmitsubaError, match="can be reached by other machines"):
        Studio("plate", tmp_path, host="0.0.0.0")


def _has(studio: object, asked: dict[str, object]) -> bool:
    state = getattr(studio.view, "state", None)
    return all(getattr(state, name) == value for name, value in asked.items())


def test_a_slider_shows_what_a_moved_wall_changes(tmp_path: Path) -> None:
    """First order at once, on the page; simulated when asked; a parameter that is refused is one line."""
    pytest.importorskip("viser")
    from sarmitsuba.apps.fit.changed_view import DIFFERENCE, IMAGE, PHASE
    from sarmitsuba.apps.studio import Studio

    (tmp_path / "yard.xml").write_text(
        GROUND.replace('<shape type="cube">', '<shape type="cube" id="house">')
    )
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        studio = Studio(str(tmp_path / "yard.xml"), tmp_path, port=free.getsockname()[1] + 2)
    studio.state = dataclasses.replace(studio.state, resolution=3.0)  # small
    tab = studio.derivative

    def until(done: Callable[[], bool]) -> None:
        turns = iter(range(400))
        studio.serve(lambda: done() or next(turns, None) is None, patience=0.05)
        assert done()

    try:
        until(lambda: "shift:house:z" in tab.parameter.options)
        assert not any("radar_ground" in option for option in tab.parameter.options) and tab.changed is None
        plain = studio._picture.image
        tab.parameter.value = "shift:house:z"
        until(lambda: tab.changed is not None)
        found = tab.changed.derivative
        assert (tab.change.min, tab.change.max, tab.change.label) == (-2.0, 2.0, "by (cm)")
        # an eighth of a wavelength of path, lambda / (16 cos(look angle))
        wavelength, look = (
            studio.view.scene.radar.waveform.wavelength,
            np.radians(studio.state.look_angle_deg),
        )
        # tol: the angle over the aperture
        assert found.largest_change == pytest.approx(wavelength / (16.0 * np.cos(look)), rel=1e-2)
        tab.which.value, tab.change.value = DIFFERENCE, 0.1
        until(lambda: tab.changed.change == pytest.approx(1e-3) and studio._picture.label == DIFFERENCE)
        shown, _ = tab.changed.picture(DIFFERENCE)
        assert np.array_equal(shown.data, np.complex64(1e-3) * found.derivative.data) and shown.data.any()
        assert "to first order" in tab.status.content and "off by up to 17 %" in tab.status.content
        tab._ask(studio._woken.set)
        until(lambda: tab.changed.simulated is not None)
        true = tab.changed.simulated.data - found.image.data
        # tol: the error that is stated, x / 2 of the change, and edges of shadows
        assert np.linalg.norm(true - shown.data) < (found.error(1e-3) + 0.05) * np.linalg.norm(true)
        assert "simulated" in tab.status.content
        tab.which.value, tab.change.value = PHASE, 1.0
        until(lambda: "beyond first order" in tab.status.content and studio._picture.label == PHASE)
        tab.parameter.value = "level:roof"  # not a material of the scene
        until(lambda: "no derivative" in tab.status.content)
        assert "\n" not in tab.status.content and tab.changed is None
        tab.parameter.value = "nothing"
        until(lambda: studio._picture.label == IMAGE and tab.status.content == "")
        assert np.array_equal(studio._picture.image, plain)
    finally:
        studio.close()


def test_a_derivative_gives_way_to_a_newer_state(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A slider that moves meanwhile ends it; it is computed again for the new state."""
    pytest.importorskip("viser")
    from sarmitsuba.apps import studio as derivative_tab
    from sarmitsuba.apps import studio as server
    from sarmitsuba.apps.fit.image_derivative import image_derivative

    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        studio = server.Studio("plate", tmp_path, port=free.getsockname()[1] + 3)
    tab, ended = studio.derivative, []

    def moved_meanwhile(*given: object, **named: object) -> object:
        if not ended:
            studio.controls["look_angle_deg"].value = 20.0
            assert studio._changed.wait(10.0)
        try:
            return image_derivative(*given, **named)
        except derivative_tab.SupersededError:
            ended.append(studio.state.look_angle_deg)
            raise

    monkeypatch.setattr(derivative_tab, "image_derivative", moved_meanwhile)
    try:
        tab.parameter.options = ("nothing", "shift:plate:z")
        tab.parameter.value = "shift:plate:z"
        turns = iter(range(400))
        studio.serve(lambda: tab.changed is not None or next(turns, None) is None, patience=0.05)
        assert ended == [20.0] and tab.changed is not None
        assert tab.changed.derivative.image.grid.shape == studio.view.image.grid.shape
        assert "to first order" in tab.status.content
    finally:
        studio.close()


def test_sliders_span_what_their_values_can_have() -> None:
    from sarmitsuba.apps.fit.changed_view import ChangeSlider
    from sarmitsuba.apps.fit.image_derivative import ImageDerivative

    def slider(name: str, value: float, rate: float) -> tuple[str, float, float]:
        found = ChangeSlider.of(ImageDerivative(name, value, None, None, rate))
        return found.unit, found.low, found.high

    assert slider("shift:a:x [m]", 0.0, 200.0) == ("cm", -2.0, 2.0)
    assert slider("level:a [dB]", -10.0, 0.115) == ("dB", -10.0, 10.0)
    assert slider("gain [dB]", 0.0, 0.0) == ("dB", -10.0, 10.0)
    assert slider("rms_height:a [m]", 0.002, 100.0) == ("mm", pytest.approx(-2.0), pytest.approx(30.0))
    assert slider("permittivity:a [1]", 1.5, 1.0) == ("1", pytest.approx(-0.5), 3.0)
    unit, low, high = slider("rotation:a [rad]", 0.0, 1000.0)
    assert unit == "deg" and low == -high == pytest.approx(-0.2)


def test_included_files_belong_to_the_scene(tmp_path: Path) -> None:
    """The radar of an included file sets the sliders, and gives way to the studio's."""
    state = first_state("car_park")
    assert (state.frequency, state.slant_range) == (16.7e9, 3000.0)
    text = scene_xml(state)
    assert "<include" not in text and text.count("<sensor") == 1 and text.count("<integrator") == 1
    (tmp_path / "scene.xml").write_text('<scene version="3.0.0"><include filename="../up.xml"/></scene>')
    (tmp_path.parent / "up.xml").write_text('<scene version="3.0.0"/>')
    with pytest.raises(SceneError, match="outside the folder"):
        first_state(str(tmp_path / "scene.xml"))
