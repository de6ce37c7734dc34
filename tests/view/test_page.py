"""The whole page in a browser: it opens, its clicks show what they should, its look switch moves the beam."""

from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from sarmitsuba.cli import main
from sarmitsuba.files import read_image, read_raw
from sarmitsuba.view.display import PictureOptions, prepare

# a quarter of the bridge's image, in coarser cells: seconds instead of half a minute
SMALLER = (
    "sar_antenna.azimuth_resolution=1",
    "sar_antenna.bandwidth=150e6",
    "range_film.image_extent_azimuth=60",
)
LONGEST_BYTES = 25e6  # of the page of a shipped scene


def rendered(scene: str, folder: Path, *definitions: str) -> Path:
    arguments = [word for text in definitions for word in ("-D", text)]
    assert main(["render", scene, "-o", str(folder), "--no-error-bars", "--quiet", *arguments]) == 0
    return folder


@pytest.fixture(scope="module")
def bridge(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """The bridge in stripmap and in spotlight; the page of both is in the first folder."""
    folder = tmp_path_factory.mktemp("bridge")
    one = rendered("bridge", folder / "stripmap", *SMALLER)
    narrow = "range_film.image_extent_azimuth=20"
    two = rendered("bridge", folder / "spotlight", "sar_antenna.mode=spotlight", *SMALLER[:2], narrow)
    assert main(["view", str(one), str(two), "--quiet"]) == 0
    return one, two


@pytest.fixture(scope="module")
def shown(bridge: tuple[Path, Path], opened: Callable[[Path], Any]) -> Any:
    return opened(bridge[0] / "page.html")


def test_page_opens_by_itself(shown: Any, bridge: tuple[Path, Path]) -> None:
    shown.idle()
    assert shown.complaints == []
    asked = [url for url in shown.requests if not url.startswith(("data:", "blob:"))]
    assert asked == [(bridge[0] / "page.html").as_uri()]
    assert (bridge[0] / "page.html").stat().st_size < LONGEST_BYTES
    assert shown.page.title().startswith("bridge")


def test_numbers_arrive_as_they_were_written(shown: Any, bridge: tuple[Path, Path]) -> None:
    raw, image = read_raw(bridge[0] / "raw.h5"), read_image(bridge[0] / "image.h5")
    got = shown.call(
        """const look = page.data.looks[0];
        return { position: Array.from(look.radar.position), center: look.pixels.center, scale: look.image.scale,
          re: Array.from(look.image.layers[0].re), im: Array.from(look.image.layers[0].im) };"""
    )
    position = np.reshape(got["position"], (-1, 3)) + got["center"]
    # tol: the middle is taken off and added again, in float64
    np.testing.assert_allclose(position, raw.radar.track.position, rtol=0.0, atol=1e-9)
    pixels = (np.array(got["re"]) + 1j * np.array(got["im"])).reshape(image.grid.shape) / got["scale"]
    error = np.abs(pixels - image.total()) ** 2
    # tol: float16 rounds to 2^-12 of a number at most, -72 dB
    assert error.sum() < 10 ** (-0.1 * 66) * (np.abs(image.total()) ** 2).sum()


def test_image_is_shown_as_bright_as_its_picture(shown: Any, bridge: tuple[Path, Path]) -> None:
    """The page took the brightest pixels for its scale: strong corners left the clutter black."""
    image = read_image(bridge[0] / "image.h5")
    black, white = prepare(image, PictureOptions(), 1600).limits
    assert shown.page.get_by_label("Brightest").input_value() == str(round(white))
    got = np.array(
        shown.call(
            """const { canvas } = page.view;
            const copy = document.createElement("canvas");
            [copy.width, copy.height] = [canvas.width, canvas.height];
            const context = copy.getContext("2d", { willReadFrequently: true });
            context.drawImage(canvas, 0, 0);
            const { data } = context.getImageData(0, 0, copy.width, copy.height);
            return Array.from(data.filter((_, i) => i % 4 === 0));"""
        )
    )
    want = 255.0 * np.clip((image.to_db() - black) / (white - black), 0.0, 1.0).ravel()
    assert 20.0 < np.median(want)  # neither black nor white
    # tol: levels of whole dB, half a dB of 50 at each end
    assert np.abs(got - want).mean() < 5.0


def test_texts_below_the_echo_stand_apart(shown: Any) -> None:
    for width in (1280, 1000):
        shown.resize(width, 800)
        texts = shown.call("page.signals.draw(); return page.signals.texts;")
        assert texts[0]["text"] == "0 m" and len(texts) >= 2
        ends = sorted((one["left"], one["right"]) for one in texts)
        assert all(first[1] <= second[0] for first, second in pairwise(ends))
    shown.resize(1280, 800)


def third_line(path: Path) -> tuple[int, int]:
    """Row and column of the bridge's third line: 30 cos(35 deg) of slant range behind the point below the deck's edge.

    The brightest row of that column, so that no pier stands in the way.
    """
    image = read_image(path / "image.h5")
    wanted = 10000.0 + 30.0 * np.cos(np.radians(35.0))
    column = int(np.argmin(np.abs(image.grid.range - wanted)))
    near = image.rcs()[:, column - 2 : column + 3]
    row, offset = divmod(int(near.argmax()), near.shape[1])
    return row, column - 2 + offset


def test_click_on_the_third_line_shows_three_bounces(shown: Any, bridge: tuple[Path, Path]) -> None:
    row, column = third_line(bridge[0])
    canvas = shown.page.locator("#image .sar-pixels")
    box = canvas.bounding_box()
    rows, columns = read_image(bridge[0] / "image.h5").grid.shape
    at = {"x": (column + 0.5) / columns * box["width"], "y": (1.0 - (row + 0.5) / rows) * box["height"]}
    canvas.click(position=at)
    shown.idle()
    text = shown.page.inner_text("#story")
    assert "Three bounces" in text and "ghost" in text
    first = shown.page.locator("#story tr.path").first
    assert first.get_attribute("data-order") == "3"
    found = shown.call(
        """const { paths } = page.look; const path = page.store.get("path");
        const start = paths.starts[path];
        return { length: paths.length[path], order: paths.order[path], drawn: page.world.groups.pick.children.length,
          points: Array.from(paths.points.slice(3 * start, 3 * start + 9)), center: page.data.center };"""
    )
    image = read_image(bridge[0] / "image.h5")
    # tol: a path of a cell of the page lies within it, two image cells at most from the pixel clicked
    assert abs(0.5 * found["length"] - image.grid.range[column]) < 3.0 * image.range_resolution_cell
    heights = np.reshape(found["points"], (3, 3))[:, 2] + found["center"][2]
    assert found["order"] == 3 and found["drawn"] > 6
    # water, the deck's near face (29.5 to 30.5 m up), water
    assert abs(heights[0]) < 0.1 and 29.4 < heights[1] < 30.6 and abs(heights[2]) < 0.1


def test_click_on_the_deck_shows_its_three_lines(shown: Any, bridge: tuple[Path, Path]) -> None:
    """The lines of a point h above water stand R, the mean of R and R', and R' away, R' from its mirror image."""
    spot = shown.call(
        """page.store.set({ drape: "ground", buildings: "solid" });
        const { world } = page;
        const center = page.data.center;
        const face = [0 - center[0], 8 - center[1], 30 - center[2]];
        world.lookAt([face[0] - 60, face[1] - 15, face[2] + 10], face);
        await new Promise((resolve) => requestAnimationFrame(resolve));
        await new Promise((resolve) => requestAnimationFrame(resolve));
        const seen = world.camera.position.clone().set(...face).project(world.camera);
        const frame = world.canvas.getBoundingClientRect();
        return [frame.left + 0.5 * (seen.x + 1) * frame.width, frame.top + 0.5 * (1 - seen.y) * frame.height];"""
    )
    shown.page.mouse.click(*spot)
    shown.idle()
    landed = shown.call(
        "return page.story.landed.map(({ order, range, point }) => ({ order, range, point }));"
    )
    radar = read_raw(bridge[0] / "raw.h5").radar
    antenna = radar.track.position[radar.track.n_pulses // 2]
    face = np.array([0.0, 8.0, 30.0])
    near, far = (float(np.linalg.norm(antenna - p)) for p in (face, face * [1, 1, -1]))
    # tol: a click is half a picture element off, here 0.1 m of height at most
    np.testing.assert_allclose(
        [one["range"] for one in landed], [near, 0.5 * (near + far), far], rtol=0, atol=0.1
    )
    center = np.array(shown.call("return page.data.center;"))
    for one in landed:
        point = np.array(one["point"]) + center
        # tol: the point of the plane solves the range equation in float64
        assert abs(np.linalg.norm(antenna - point) - one["range"]) < 1e-6
        assert abs(point[2]) < 1e-9
    assert "steel" in shown.page.inner_text("#story")


def test_look_switch_moves_the_beam(shown: Any, bridge: tuple[Path, Path]) -> None:
    """Stripmap's beam goes along with the platform, spotlight's stays where it is."""
    read = """const last = page.look.radar.time.length - 1; const ends = [];
        for (const pulse of [0, last]) { page.store.set({ pulse }); ends.push(page.world.beamCenter); }
        return ends;"""
    travelled = {}
    for look, folder in enumerate(bridge):
        shown.page.locator(f"#looks [data-look='{look}']").click()
        first, last = shown.call(read)
        track = read_raw(folder / "raw.h5").radar.track
        flown = float(np.linalg.norm(track.position[-1] - track.position[0]))
        travelled[look] = float(np.linalg.norm(np.subtract(last, first))) / flown
        assert flown > 100.0
    # tol: boresight travels as float32 unit vectors, 6e-8 of 10 km
    assert travelled[0] == pytest.approx(1.0, abs=1e-4)
    assert travelled[1] == pytest.approx(0.0, abs=1e-4)
    shown.page.locator("#looks [data-look='0']").click()


@pytest.mark.slow
def test_image_builds_up_to_the_finished_one(shown: Any, bridge: tuple[Path, Path]) -> None:
    """At the last pulse, with the run's window, the browser's image is the run's."""
    shown.page.keyboard.press("End")
    got = shown.call(
        """page.store.set({ building: true, pulse: page.look.radar.time.length - 1 });
        await page.refocus.running;
        const { re, im } = page.view.live;
        page.store.set({ building: false });
        return [Array.from(re), Array.from(im), page.view.live === null];"""
    )
    image = read_image(bridge[0] / "image.h5").total()
    mine = (np.array(got[0]) + 1j * np.array(got[1])).reshape(image.shape)
    coherence = abs(np.vdot(image, mine)) / np.sqrt(np.vdot(image, image).real * np.vdot(mine, mine).real)
    assert coherence > 0.999
    assert got[2]  # the finished image again


def test_keys_and_help(shown: Any) -> None:
    shown.page.locator("#world-canvas").focus()
    shown.page.keyboard.press("Home")
    shown.page.keyboard.press("ArrowRight")
    assert shown.call("return page.store.get('pulse');") == 1
    shown.page.keyboard.press("i")
    assert shown.call("return page.store.get('drape');") == "slant"
    shown.page.keyboard.press("?")
    assert "play or pause" in shown.page.inner_text("#help-text")
    shown.page.keyboard.press("Escape")
    shown.page.keyboard.press("c")
    text = shown.page.inner_text("#comparison")
    assert "stripmap" in text and "spotlight" in text and "Flicker" in text
    shown.page.keyboard.press("Escape")


@pytest.mark.slow
def test_tour_explains_what_newcomers_ask(shown: Any) -> None:
    """Why high things lean, where the shadow falls, what the line at the foot is."""
    shown.page.keyboard.press("Escape")
    shown.page.locator("#tour").click()
    texts = []
    while True:
        shown.idle()
        texts.append(shown.page.inner_text("#story"))
        button = shown.page.locator("[data-tour='1']")
        if button.inner_text() == "Done":
            break
        shown.call("page.store.set({ playing: false });")
        button.click()
    together = "\n".join(texts)
    for words in ("Layover", "shadow", "Three bounces", "Your turn"):
        assert words in together
    shown.page.keyboard.press("Escape")
    assert shown.complaints == []
