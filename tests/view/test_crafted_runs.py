"""Runs whose names and values carry script: their page opens, shows them as text, and nothing of them runs."""

import json
from collections.abc import Callable, Collection, Iterator
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from sarmitsuba.cli import main
from sarmitsuba.view.page.payload import PAGE
from sarmitsuba.view.page.run_folder import read_run
from sarmitsuba.view.page.write import write_page

# each calls window.ran, which stays undefined unless one of them runs
EVIL = (
    "<img src=x onerror=\"window.ran='img'\">",
    "</script><script>window.ran='script'</script>",
    '"><svg onload="window.ran=\'svg\'">',
    "<iframe srcdoc=\"<script>parent.ran='frame'</script>\"></iframe>",
    "${window.ran='template'}`;window.ran='tick'//",
    "<a href=\"javascript:window.ran='link'\">x</a>",
    "{{policy}} {{facts}} \u2028 --> ]]> &lt;script&gt;",
)


def evil(number: int = 0) -> str:
    """All of them together, another one first each time."""
    return " ".join(EVIL[number % len(EVIL) :] + EVIL[: number % len(EVIL)])


def crafted(value: Any, number: int = 0, keep: Collection[str] = ()) -> Any:
    """The value with every text in it replaced, names of entries and the entries ``keep`` apart."""
    if isinstance(value, str):
        return evil(number)
    if isinstance(value, dict):
        return {
            key: entry if key in keep else crafted(entry, number + i, keep)
            for i, (key, entry) in enumerate(value.items())
        }
    if isinstance(value, list | tuple):
        return [crafted(entry, number + i, keep) for i, entry in enumerate(value)]
    return value


# words that the page's own code chooses by: names of its making
CHOICES = {"kind", "swept", "mode", "look_side", "lookSide", "frame", "type", "compression"}


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("crafted") / "out"
    small = (
        "range_film.image_extent_azimuth=4",
        "range_film.image_extent_range=4",
        "sar_antenna.slant_range=1000",
    )
    words = [word for text in small for word in ("-D", text)]
    assert main(["render", "point", "-o", str(folder), "--no-error-bars", "--quiet", *words]) == 0
    return folder


@pytest.fixture
def silent(opened: Callable[..., Any]) -> Iterator[Callable[[Path], Any]]:
    """Open a page and try all that it offers; nothing may have run, been asked for or been complained of."""

    def call(path: Path) -> Any:
        one = opened(path, window=(640, 400))
        one.page.keyboard.press("?")
        one.page.keyboard.press("Escape")
        for key in ("l", "s", "g", "i", "1", "2", "3", "ArrowRight", "End"):
            one.page.keyboard.press(key)
        one.page.wait_for_timeout(300)  # images that fail to load say so late
        assert one.page.evaluate("window.ran") is None
        strange = "img, iframe, svg, object, embed, a[href^=javascript], [onerror], [onload], [srcdoc]"
        assert one.page.locator(strange).count() == 0
        # the policy refuses nothing, because nothing was tried
        assert one.complaints == []
        asked = [url for url in one.requests if not url.startswith(("data:", "blob:"))]
        assert asked == [path.as_uri()]
        return one

    return call


def test_what_the_readers_let_through_is_text(
    run: Path, silent: Callable[[Path], Any], tmp_path: Path
) -> None:
    """Metadata, notes and the record of a folder as a stranger may write them, through `view` itself."""
    folder = tmp_path / "results"
    folder.mkdir()
    for name in ("raw.h5", "image.h5"):
        (folder / name).write_bytes((run / name).read_bytes())
        with h5py.File(folder / name, "r+") as file:
            metadata = json.loads(file["metadata"].asstr()[()])
            # a window or a focuser of another name is refused
            metadata = crafted(metadata) | {
                "focus": metadata.get("focus", {}),
                "notes": [evil(2)],
                "scene": evil(1),
            }
            del file["metadata"]
            file["metadata"] = json.dumps(metadata)
            file.attrs["title"] = evil(3)
    record = json.loads((run / "parameters.json").read_text(encoding="utf-8"))
    keep = {"scene": record["scene"], "command": record["command"], "definitions": record["definitions"]}
    (folder / "parameters.json").write_text(json.dumps(crafted(record) | keep), encoding="utf-8")
    assert main(["view", str(folder), "--quiet"]) == 0
    silent(folder / "page.html")


def test_what_no_reader_lets_through_is_text_too(
    run: Path, silent: Callable[[Path], Any], tmp_path: Path
) -> None:
    """Every text of the page's numbers, whatever checks there are before; markup itself is stopped by the policy."""
    from sarmitsuba.view.page.payload import page_payload

    payload = page_payload([read_run(run)], None, lambda _: None)
    write_page(tmp_path / "page.html", crafted(payload, keep=CHOICES))
    one = silent(tmp_path / "page.html")
    assert "onerror=" in one.page.inner_text("body")  # shown, as text
    one.page.evaluate("""(evil) => { document.getElementById("title").innerHTML = evil; }""", evil())
    one.page.wait_for_timeout(300)
    assert one.page.evaluate("window.ran") is None
    assert any("Content Security Policy" in text for text in one.complaints)
    with pytest.raises(Exception, match="Failed to fetch"):
        one.page.evaluate("fetch('http://127.0.0.1:9/')")


def test_script_in_a_sweep_is_text(silent: Callable[[Path], Any], tmp_path: Path) -> None:
    """Title, polarisations, meshes, materials and points of an RCS page."""
    channels = [
        {"name": evil(i), "error": 1.0, "total": np.array([1.0, 2.0]), "phase": np.zeros(2), "orders": []}
        for i in (0, 1)
    ]
    point = {"name": evil(5), "position": np.zeros(3), "label": evil(6)}
    scene = {"glb": np.zeros(0, np.uint8), "meshes": [evil(3)], "materials": [evil(4)], "points": [point]}
    payload = {
        "title": evil(2), "version": evil(), "center": np.zeros(3), "radius": 1.0, "below": 1.0, "frequency": 1e9,
        "swept": "azimuth", "polar": False, "whole": False, "azimuth": np.array([0.0, 1.0]), "elevation": np.zeros(2),
        "image": None, "scenes": [scene], "channels": channels, "statement": {"text": evil(7), "warning": evil(8)},
    }  # fmt: skip
    write_page(tmp_path / "page.html", payload, PAGE)
    page = silent(tmp_path / "page.html").page
    assert "onerror=" in page.inner_text("#title")
