"""The page of an RCS sweep in a browser: its numbers are the table's, its arrow points from where the radar is."""

import csv
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from sarmitsuba.cli import main
from sarmitsuba.view.page.payload import PAGE
from sarmitsuba.view.page.write import write_page

SWEEP = ("--frequency", "2e9", "--azimuth", "150:210:4", "--pol", "HH,HV")


@pytest.fixture(scope="module")
def sweep(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("rcs") / "out"
    assert main(["rcs", "dihedral", "-o", str(out), "--page", "--quiet", *SWEEP]) == 0
    return out


@pytest.fixture(scope="module")
def shown(sweep: Path, opened: Callable[[Path], Any]) -> Any:
    """The open page; it fails the test at the end of the module if anything was complained of."""
    one = opened(sweep / "page.html")
    yield one.page
    assert one.complaints == []


def table(folder: Path) -> dict[str, list[float]]:
    with (folder / "rcs.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    return {name: [float(row[name]) for row in rows] for name in rows[0]}


def numbers(page: Any, row: str) -> list[float]:
    cells = page.locator(f"#numbers tr[data-order='{row}'] td").all_inner_texts()
    return [-np.inf if text == "none" else float(text.split()[0]) for text in cells]


def test_numbers_are_those_of_the_table(shown: Any, sweep: Path) -> None:
    written = table(sweep)
    orders = [name.split("_")[2] for name in written if name.startswith("HH_order_")]
    assert "2" in orders and int(shown.get_attribute("#aspect", "max")) == len(written["HH_dbsm"]) - 1
    for aspect in (0, 7, len(written["HH_dbsm"]) - 1):
        shown.locator("#aspect").fill(str(aspect))
        assert f"azimuth {written['azimuth_deg'][aspect]:.2f}°" in shown.inner_text("#aspect-text")
        for row, column in [("0", "{}_dbsm"), *((n, f"{{}}_order_{n}_dbsm") for n in orders)]:
            expected = [written[column.format(name)][aspect] for name in ("HH", "HV")]
            # tol: the page rounds to two digits, the table to four
            np.testing.assert_allclose(numbers(shown, row), expected, rtol=0.0, atol=0.00511)


def test_arrow_comes_from_the_radar(shown: Any, sweep: Path) -> None:
    """Azimuth from +x towards +y, elevation upwards; keys step through the aspects."""
    written = table(sweep)
    shown.locator("#world-canvas").focus()
    shown.keyboard.press("Home")
    shown.keyboard.press("ArrowRight")
    got = shown.evaluate("() => window.sarmitsuba.view.page.target.radar")
    azimuth, elevation = np.radians([written["azimuth_deg"][1], written["elevation_deg"][1]])
    wanted = [np.cos(azimuth) * np.cos(elevation), np.sin(azimuth) * np.cos(elevation), np.sin(elevation)]
    # tol: angles of the table have nine digits
    np.testing.assert_allclose(np.array(got) / np.linalg.norm(got), wanted, rtol=0.0, atol=1e-8)
    shown.keyboard.press("l")
    assert shown.inner_text("#curves figcaption").startswith("HV")
    shown.keyboard.press("l")


def test_a_drag_in_the_plot_goes_to_its_aspect(shown: Any) -> None:
    """The plot's own scale leads back to every aspect."""
    same = shown.evaluate(
        """() => { const { plot } = window.sarmitsuba.view.page;
        return Array.from(plot.angle).map((angle) => plot.aspectAt(...plot.at(angle, plot.top - 1))); }"""
    )
    assert same == list(range(len(same)))


def test_every_control_has_its_turn_by_keyboard_with_a_ring(shown: Any) -> None:
    seen: dict[int, str] = {}
    for _ in range(60):
        shown.keyboard.press("Tab")
        number, name, ring = shown.evaluate(
            """() => { const at = document.activeElement; const style = getComputedStyle(at);
            const number = at === document.body ? -1 : [...document.querySelectorAll("*")].indexOf(at);
            return [number, at.id || at.textContent, style.outlineStyle + style.outlineWidth]; }"""
        )
        if number in seen:
            break
        if number >= 0:  # else between the last control and the first
            assert ring == "solid2px", name
            seen[number] = name
    assert {"help", "world-canvas", "Overview", "play", "aspect"} <= set(seen.values())


def test_aspects_without_any_return_can_be_shown(opened: Callable[[Path], Any], tmp_path: Path) -> None:
    """A few directions, one of them without return: infinity has no number in JSON."""
    payload = {
        "title": "nothing", "center": np.zeros(3), "radius": 1.0, "below": 1.0, "frequency": 1e9, "swept": "azimuth",
        "polar": False, "whole": False, "azimuth": np.array([0.0, 1.0]), "elevation": np.zeros(2), "image": None,
        "scenes": [{"glb": np.zeros(0, np.uint8), "meshes": [], "materials": [], "points": []}],
        "statement": {"text": "errors: none known", "warning": ""},
        "channels": [
            {"name": "HH", "error": None, "total": np.array([-np.inf, 3.0]), "phase": np.zeros(2), "orders": []}
        ],
    }  # fmt: skip
    write_page(tmp_path / "page.html", payload, PAGE)
    page = opened(tmp_path / "page.html").page
    assert numbers(page, "0") == [3.0]  # the strongest aspect comes first
    page.locator("#aspect").fill("0")
    assert numbers(page, "0") == [-np.inf]
