"""``auto`` chooses by what focusers state, ``all`` compares them; what they state holds."""

import dataclasses
import json
import math
from collections.abc import Iterator
from pathlib import Path
from typing import ClassVar

import numpy as np
import pytest

from sarmitsuba import cli
from sarmitsuba.core.constants import SUBSET_SHARES
from sarmitsuba.core.errors import DataError
from sarmitsuba.radar.image_request import ImageRequest
from sarmitsuba.radar.radar import Radar
from sarmitsuba.radar.track import Track
from sarmitsuba.signal.focusing import FOCUSERS, Focused, Focuser, FocusTask, default_grid
from sarmitsuba.signal.focusing.focus import data_error_db
from sarmitsuba.signal.focusing.focuser import Auto, parse_focuser
from sarmitsuba.signal.focusing.ideal import ideal_echoes, ideal_radar
from sarmitsuba.signal.image import ImageGrid
from sarmitsuba.signal.metrics import image_error_db
from sarmitsuba.signal.raw_data import Layer, RawData
from tests.support.unweighted import compare_focusers, focus

REQUEST = ImageRequest(extent_azimuth=30.0, extent_range=30.0)


@dataclasses.dataclass(frozen=True)
class Stated(Focuser):
    """Backprojection that states other figures."""

    name: ClassVar[str] = "test_stated"
    title: ClassVar[str] = "states what the test wants"
    figures: ClassVar[dict[str, float]] = {}

    def error_db(self, radar: Radar, grid: ImageGrid) -> float:
        return self.figures["error"]

    def cpu_seconds(self, radar: Radar, grid: ImageGrid) -> float:
        return self.figures["seconds"]

    def refusal(self, radar: Radar, grid: ImageGrid) -> str:
        return "" if self.figures else "it is not being tested"

    def focus(self, task: FocusTask) -> Focused:
        return FOCUSERS["backprojection"].focus(task)


FOCUSERS.register(Stated())


@pytest.fixture
def figures() -> Iterator[dict[str, float]]:
    yield Stated.figures
    Stated.figures.clear()


def data(n_pulses: int = 0) -> RawData:
    radar = ideal_radar(resolution=1.0, bandwidth=150e6)
    if n_pulses:
        radar = ideal_radar(resolution=1.0 * radar.track.n_pulses / n_pulses, bandwidth=150e6)
    return dataclasses.replace(ideal_echoes(radar, [[0.3, -0.2, 0.0], [8.0, 7.0, 0.0]]), request=REQUEST)


@pytest.mark.parametrize(
    ("error", "seconds", "chosen"),
    [(-60.0, 1e-9, True), (-40.0, 1e-9, False), (-60.0, 1e9, False), (math.nan, 1e-9, False)],
)
def test_auto_takes_the_cheapest_that_is_good_enough(
    figures: dict[str, float], error: float, seconds: float, chosen: bool
) -> None:
    figures |= {"error": error, "seconds": seconds}
    image = focus(data(), focuser="auto,error=-50")
    facts = image.metadata["focus"]
    assert (facts["method"] == "test_stated") == chosen
    # says what spoke for it and against the others
    for focuser in FOCUSERS:
        assert focuser.name in facts["chosen"]
    if math.isnan(error):
        assert "test_stated: states no error here" in facts["chosen"]


def test_auto_keeps_to_what_can_focus() -> None:
    raw = data()
    track = raw.radar.track
    bend = track.position + np.outer(np.linspace(-1, 1, track.n_pulses) ** 2, [0.0, 0.0, 5.0])
    curved = dataclasses.replace(raw.radar, track=Track.from_samples(track.time, bend))
    facts = focus(dataclasses.replace(raw, radar=curved), focuser="auto,error=-50").metadata["focus"]
    assert facts["method"] in {
        f.name for f in FOCUSERS if not f.refusal(curved, default_grid(curved, REQUEST))
    }
    assert "omega_k: the track is curved" in facts["chosen"]


def test_auto_says_when_nothing_is_good_enough() -> None:
    with pytest.raises(
        DataError, match=r"^focuser auto: none states an error of -300 dB here; raise error"
    ) as found:
        focus(data(), focuser="auto,error=-300")
    assert "\n" not in str(found.value)
    with pytest.raises(DataError, match="option 'cost' is unknown; it takes error"):
        parse_focuser("auto,cost=3")
    assert "auto" not in FOCUSERS and isinstance(parse_focuser("auto"), Auto)


def large() -> tuple[Radar, ImageGrid]:
    """A radar and a grid for which the factorised form saves seconds."""
    radar = ideal_radar(slant_range=5e3, resolution=0.3, bandwidth=500e6, n_samples=1200)
    return radar, default_grid(radar, ImageRequest(grid="ground", extent_azimuth=120.0, extent_range=150.0))


@pytest.mark.parametrize(
    ("own", "method", "at_most"),
    [
        (math.nan, "factorised", -60.0),
        (-20.0, "factorised", -60.0),
        (-45.0, "factorised", -65.0),
        (-90.0, "backprojection", -100.0),
        (-math.inf, "backprojection", -100.0),
    ],
)
def test_the_default_never_errs_as_much_as_the_data(own: float, method: str, at_most: float) -> None:
    radar, grid = large()
    chosen, reason = Auto().resolved(radar, grid, lambda: own)
    assert chosen.name == method and chosen.error_db(radar, grid) <= at_most
    assert method in reason and "\n" not in reason
    # a small image, on the same terms, is the plain sum
    small = default_grid(radar, REQUEST)
    assert Auto().resolved(radar, small, lambda: own)[0] == FOCUSERS["backprojection"]


def test_the_default_is_the_plain_sum_where_the_fast_form_is_refused_or_slow() -> None:
    radar, grid = large()
    low = dataclasses.replace(grid, height=1e5)
    chosen, reason = Auto().resolved(radar, low)
    assert chosen == FOCUSERS["backprojection"] and "antenna is not above" in reason
    narrow = dataclasses.replace(grid, azimuth=grid.azimuth[:3])
    assert Auto().resolved(radar, narrow)[0] == FOCUSERS["backprojection"]


@pytest.mark.parametrize("shares", [(-30.0, -27.0), (-55.0, -50.0)])
def test_the_error_of_the_data_is_that_between_their_subsets(shares: tuple[float, float]) -> None:
    rng = np.random.default_rng(7)
    radar = data().radar
    shape = radar.track.n_pulses, radar.window.n_samples
    true, *wrong = (rng.standard_normal(shape) + 1j * rng.standard_normal(shape) for _ in range(3))
    planes = [
        SUBSET_SHARES[i + 1] * (true + 10.0 ** (share / 20.0) * error)
        for i, (share, error) in enumerate(zip(shares, wrong, strict=True))
    ]
    layers = tuple(Layer("VV", subset=i + 1) for i in range(2))
    raw = RawData(np.array(planes, dtype=np.complex64), layers, "compressed", radar)
    apart = 10.0 * math.log10(0.25 * sum(10.0 ** (share / 10.0) for share in shares))
    assert data_error_db(raw) == pytest.approx(
        apart, abs=0.2
    )  # tol: three standard errors of the noise's energy
    blocks = dataclasses.replace(raw, metadata={"sampling": {"block_error_db": apart}})
    assert data_error_db(blocks) == pytest.approx(apart + 3.0, abs=0.2)  # tol: the same
    alone = RawData(raw.data[:1], (Layer("VV"),), "compressed", radar)
    assert math.isnan(data_error_db(alone))
    assert data_error_db(dataclasses.replace(alone, metadata={"statistics": {"rays": 0}})) == -math.inf


@pytest.mark.parametrize("seed", [1, *(pytest.param(n, marks=pytest.mark.slow) for n in (0, 2, 3, 4, 5))])
def test_stated_errors_hold(seed: int) -> None:
    """Of every focuser that states one, against the kernel of eight taps, which is at the end of float32."""
    rng = np.random.default_rng(seed)
    radar = ideal_radar(
        slant_range=float(rng.choice([5e3, 10e3, 30e3])),
        resolution=float(rng.uniform(0.5, 1.5)),
        bandwidth=float(rng.uniform(50e6, 300e6)),
        squint_angle=float(rng.uniform(-0.25, 0.25)),
    )
    extent = float(rng.uniform(20.0, 120.0))
    request = ImageRequest(extent_azimuth=extent, extent_range=60.0)
    grid = default_grid(radar, request)
    points = np.column_stack([rng.uniform(-0.4, 0.4, (3, 2)) * [60.0, extent], np.zeros(3)])
    raw = ideal_echoes(radar, points)
    exact = focus(raw, grid, focuser="backprojection,interpolation=kernel:8,oversampling=4").data
    tested = 0
    for name in [
        *FOCUSERS.names,
        "backprojection,interpolation=linear",
        "backprojection,interpolation=kernel:4",
    ]:
        focuser = parse_focuser(name)
        if focuser.refusal(radar, grid) or math.isnan(focuser.error_db(radar, grid)):
            continue
        image = focus(raw, grid, focuser=focuser)
        assert image_error_db(image.data, exact) < focuser.error_db(radar, grid), name
        tested += 1
    assert tested >= 3


def test_all_are_compared_with_the_reference() -> None:
    results = compare_focusers(data(), default_grid(data().radar, REQUEST))
    assert [r.name for r in results] == [
        "backprojection",
        *(n for n in FOCUSERS.names if n != "backprojection"),
    ]
    assert results[0].error_db == -math.inf and results[0].image is not None
    by_name = {r.name: r for r in results}
    assert by_name["test_stated"].refusal == "it is not being tested" and by_name["test_stated"].image is None
    assert by_name["omega_k"].error_db < -60.0


def test_commands_choose_and_compare(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    data().save(tmp_path / "raw.h5")
    command = ["focus", str(tmp_path / "raw.h5"), "-o"]
    assert cli.main([*command, str(tmp_path / "one"), "--focuser", "auto,error=-50"]) == 0
    shown = capsys.readouterr().out
    assert "focuser: " in shown and "CPU s" in shown
    record = json.loads((tmp_path / "one" / "parameters.json").read_text())
    assert record["focus"]["method"] in FOCUSERS.names and record["focus"]["chosen"] in shown

    assert cli.main([*command, str(tmp_path / "all"), "--focuser", "all"]) == 0
    shown = capsys.readouterr().out
    assert "test_stated: refused: it is not being tested" in shown and "omega_k: " in shown
    assert (tmp_path / "all" / "focusers.png").stat().st_size > 1000
    assert (tmp_path / "all" / "image.h5").is_file()
    record = json.loads((tmp_path / "all" / "parameters.json").read_text())
    assert record["focusers"][0]["focuser"] == "backprojection"
