"""No picture that a command writes has texts that overlap or are cut."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg

from sarmitsuba.cli import main
from sarmitsuba.signal.image import ImageGrid, SarImage
from sarmitsuba.signal.raw_data import Layer
from sarmitsuba.view.figure import Figure
from sarmitsuba.view.polar import AspectCurves, aspect_figure
from sarmitsuba.view.quicklook import quicklook, quicklook_by_order
from tests.support.pictures import find_text_faults


@pytest.fixture
def faults(monkeypatch: pytest.MonkeyPatch) -> Iterator[dict[int, list[str]]]:
    """Faults of every picture written meanwhile, by their order."""
    found: dict[int, list[str]] = {}
    write = FigureCanvasAgg.print_figure

    def checked(self: FigureCanvasAgg, *arguments: object, **options: object) -> object:
        out = write(self, *arguments, **options)
        found[len(found)] = find_text_faults(self.figure)
        return out

    monkeypatch.setattr(FigureCanvasAgg, "print_figure", checked)
    yield found


def test_faults_are_found() -> None:
    figure = Figure(figsize=(3.0, 2.0), dpi=100)
    for x, y, text in (
        (0.1, 0.5, "one"),
        (0.15, 0.52, "two"),
        (0.9, 0.1, "beyond the edge"),
        (0.5, 0.9, "good"),
    ):
        figure.text(x, y, text)
    first, second = find_text_faults(figure)
    assert "'beyond the edge' leaves" in first and "'one' overlaps 'two'" in second


@pytest.mark.parametrize("ends", [(0.0, 350.0), (90.0, 270.0), (10.0, 40.0)])
def test_cross_sections_over_aspect(ends: tuple[float, float]) -> None:
    angle = np.linspace(*ends, 36)
    total = 20.0 * np.cos(np.radians(7.0 * angle))
    curves = [
        AspectCurves(name, total, {f"{n} bounces": total - 5 * n for n in (1, 2, 3)}) for name in ("HH", "VV")
    ]
    figure = aspect_figure(angle, curves, swept="azimuth", title="body", note="expected error " * 12)
    assert find_text_faults(figure) == []


@pytest.mark.parametrize("heading", [0.0, 40.0, 90.0, 180.0, 225.0, 270.0])
@pytest.mark.parametrize("shape", [(60, 9), (9, 60), (40, 40)])
def test_quick_looks_of_all_headings(shape: tuple[int, int], heading: float) -> None:
    """Narrow, wide and square images, the compass pointing anywhere, bounces together and apart."""
    c, s = np.cos(np.radians(heading)), np.sin(np.radians(heading))
    rng = np.random.default_rng(3)
    data = (rng.normal(size=(3, *shape)) + 1j * rng.normal(size=(3, *shape))).astype(np.complex64)
    grid = ImageGrid(
        "slant",
        np.arange(shape[0]) * 1.0,
        9995.0 + np.arange(shape[1]) * 1.0,
        np.array([0.0, 0.0, 5000.0]),
        np.array([s, c, 0.0]),
        np.array([c, -s, 0.0]),
    )
    facts = {"scene": "a scene with a long name", "look_side": "right"}
    layers = tuple(Layer("VV", n) for n in (1, 2, 3))
    image = SarImage(data, layers, grid, 0.031, 0.5, 0.5, np.full(shape[1], 0.6), facts)
    assert find_text_faults(quicklook(image)) == []
    assert find_text_faults(quicklook_by_order(image)) == []


@pytest.mark.slow
def test_pictures_of_commands(faults: dict[int, list[str]], tmp_path: Path) -> None:
    """A narrow image of three channels with kept orders, a wide one with clutter, and what is made of them."""
    narrow, wide = str(tmp_path / "narrow"), str(tmp_path / "wide")
    three = ("-D", "polarisation=HH,HV,VV", "-D", "sar_path.keep_orders=true")
    coarse = ("-D", "range_film.pixel_spacing_azimuth=1", "-D", "range_film.pixel_spacing_range=1")
    for arguments in (
        (
            "render",
            "dihedral",
            "-o",
            narrow,
            "--labels",
            *three,
        ),
        ("render", "buildings16", "-o", wide, "--method", "image", "--labels", *coarse),
        ("quality", narrow),
        ("quality", wide),
        ("polarimetry", narrow),
        ("picture", wide, "--outlines", "--with-view", "-o", str(tmp_path / "plan.png")),
        ("depth", "dihedral", "--deepest", "3", "--no-times", "-o", str(tmp_path / "depth")),
        ("rcs", "trihedral", "--azimuth", "90:270:5", "--no-image", "-o", str(tmp_path / "rcs")),
        ("insar", "dihedral", "-o", str(tmp_path / "insar")),
    ):
        assert main(list(arguments)) == 0
    assert len(faults) > 15
    assert {n: found for n, found in faults.items() if found} == {}
