"""Errors of an image by their cause, as metadata give them."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import sarmitsuba
from sarmitsuba.analysis.account import Account, StageTime, account
from sarmitsuba.analysis.error_budget import BOUND, LAW, MEASURED, UNKNOWN, error_budget
from sarmitsuba.signal.gridding import gridding_kernel
from sarmitsuba.signal.image import SarImage
from tests.support.unweighted import focus

PILOT = {"patches": 1280, "energy_from_order_upper_db": [0.0, -12.5, -41.5, None]}


@pytest.fixture(scope="module")
def image() -> SarImage:
    return focus(sarmitsuba.simulate(sarmitsuba.load_scene("point"), seed=1))


def with_metadata(image: SarImage, **parts: Any) -> dict[str, Any]:
    """Parts of the budget by name, of the image with other metadata."""
    return {part.name: part for part in error_budget(replace(image, metadata={**image.metadata, **parts}))}


def test_a_point_has_no_error_of_rays_bounces_or_blocks(image: SarImage) -> None:
    parts = with_metadata(image)
    assert list(parts) == [
        "rays",
        "bounces left out",
        "blocks of pulses",
        "gridding",
        "focuser",
        "effects left out",
        "theory of metal",
    ]
    assert parts["bounces left out"].error_db == parts["blocks of pulses"].error_db == -math.inf
    assert parts["rays"].error_db == -math.inf and parts["rays"].why == "nothing is traced"
    assert parts["gridding"].error_db == -math.inf and parts["gridding"].why == "nothing is gridded"
    traced = with_metadata(image, statistics={"rays": 7})
    assert traced["gridding"].error_db == pytest.approx(gridding_kernel(4).error_db + 3.01, abs=0.01)
    assert parts["focuser"].known == MEASURED and parts["focuser"].samples >= 16
    assert parts["focuser"].error_db < -50.0 and not parts["focuser"].contradicts
    assert parts["theory of metal"].known == UNKNOWN
    assert str(parts["bounces left out"]) == "bounces left out none"


@pytest.mark.parametrize(
    ("depth", "text"),
    [
        (1, "bounces left out -12.5 dB, measured here (1280)"),
        (2, "bounces left out -41.5 dB, measured here (1280)"),
        (3, "bounces left out none"),
        (4, "bounces left out not measured"),
    ],
)
def test_bounces_are_those_beyond_the_last_one_followed(image: SarImage, depth: int, text: str) -> None:
    effects = {
        "max_depth": depth,
        "pilot": PILOT,
        "effects": {"max_depth": {"on": True, "error_is": "measured"}},
    }
    assert str(with_metadata(image, effects=effects)["bounces left out"]) == text


def test_effects_left_out_add_up_as_energies(image: SarImage) -> None:
    rng = np.random.default_rng(25)
    errors = rng.uniform(-70.0, -30.0, 5)
    effects: dict[str, Any] = {
        f"effect {i}": {"on": False, "error_is": "measured", "error_db": float(x)}
        for i, x in enumerate(errors)
    }
    effects |= {
        "on": {"on": True, "error_is": "measured", "error_db": 3.0},
        "nothing": {"on": False, "error_is": "none", "error_db": None},
        "key_pulse_interval": {"on": False, "error_is": "measured", "error_db": 0.0},
    }
    part = with_metadata(image, effects={"effects": effects})["effects left out"]
    assert part.known == MEASURED
    assert part.error_db == pytest.approx(10.0 * np.log10(np.sum(10.0 ** (errors / 10.0))), abs=1e-9)
    effects["open"] = {"on": False, "error_is": "unknown", "error_db": None}
    part = with_metadata(image, effects={"effects": effects})["effects left out"]
    assert part.known == UNKNOWN and "open" in part.why


def test_rays_are_those_of_the_worst_channel(image: SarImage) -> None:
    bars = {c: {"error_db": x, "source": "two sets"} for c, x in (("HH", -30.0), ("VV", -22.0))}
    part = with_metadata(image, sampling_error=bars)["rays"]
    assert (part.error_db, part.known, part.why) == (-22.0, MEASURED, "two sets")
    traced = with_metadata(image, sampling_error={}, statistics={"rays": 7})
    assert traced["rays"].known == UNKNOWN


@pytest.mark.parametrize(
    "junk", [None, 3, "x", [1], {"a": {"b": None}}, {"max_depth": "y", "effects": [1]}, True]
)
def test_metadata_of_other_kinds_are_taken_as_missing(image: SarImage, junk: object) -> None:
    names = ("sampling_error", "effects", "sampling", "settings", "focus", "method")
    parts = with_metadata(image, **dict.fromkeys(names, junk))
    assert all(part.as_dict()["known"] in (UNKNOWN, "none") for part in parts.values())


@pytest.mark.parametrize(("shown", "depth", "error"), [(-0.9, 1, -12.5), (-3.0, 1, -9.5), (-20.0, 1, 0.0)])
def test_bounces_left_out_may_all_be_in_the_image(
    image: SarImage, shown: float, depth: int, error: float
) -> None:
    effects = {"max_depth": depth, "pilot": PILOT}
    focus = {**image.metadata["focus"], "shown_energy_db": shown}
    part = with_metadata(image, effects=effects, focus=focus)["bounces left out"]
    assert part.error_db == pytest.approx(error) and part.known == (BOUND if shown < -1.0 else MEASURED)
    assert ("the image shows" in part.why) == (shown < -1.0)


def test_advice_is_for_the_largest_error_and_the_largest_saving(image: SarImage) -> None:
    facts = {
        "processor_seconds": {"trace": 10.0, "plan": 1.0},
        "ray_share_of_tracing": 0.9,
        "ray_spacing_settings": {"ray_spacing": 0.2, "diffuse_ray_spacing": 0.3},
        "statistics": {"rays": 100, "hits": 95},
        "sampling": {"key_pulse_interval": 64, "block_error_db": -50.0},
        "settings": {"gridding_width": 4, "key_pulse_interval": 64},
        "effects": {"max_depth": 2, "pilot": {"energy_from_order_upper_db": [0.0, -12.0, -55.0, None]}},
        "refinement": {},
    }
    stages = {"trace": StageTime(6.0, 10.0), "plan": StageTime(1.0, 1.0)}

    def advised(error_db: float, **more: Any) -> Account:
        bars = {"VV": {"error_db": error_db, "source": "two sets"}}
        metadata = {**image.metadata, **facts, "sampling_error": bars, **more}
        return account(replace(image, metadata=metadata), stages)

    found = advised(
        -25.0
    )  # the rays decide: four times of them; blocks twice as long save half of the tracing
    assert found.finer is not None and found.coarser is not None
    assert found.finer.options == "-D sar_path.ray_spacing=0.1 -D sar_path.diffuse_ray_spacing=0.15"
    assert found.finer.error_db == pytest.approx((-25.0, -25.0 - 16.6 * math.log10(2.0)))
    assert found.finer.seconds == pytest.approx(27.0)
    assert found.coarser.options == "-D sar_path.key_pulse_interval=128"
    assert found.coarser.seconds == pytest.approx(-5.0)
    # the sum is that of energies, and rises by less than half a dB
    parts = [-25.0, -50.0, -55.0, *(p.error_db for p in found.parts[3:5])]
    assert found.total_db == pytest.approx(10 * math.log10(sum(10 ** (x / 10) for x in parts)), abs=1e-9)
    assert found.coarser.total_db[1] - found.coarser.total_db[0] < 0.5
    found = advised(-60.5, settings={"gridding_width": 2, "key_pulse_interval": 0})  # a narrow kernel decides
    assert found.finer is not None and "gridding_width" in found.finer.options
    found = advised(-25.0, sampling_error={})
    assert "not measured" in found.advice[0]


@pytest.mark.parametrize(("bound", "advised"), [(-25.0, "key_pulse_interval=32"), (-12.0, "")])
def test_a_loose_bound_does_not_outweigh_a_measured_error(
    image: SarImage, bound: float, advised: str
) -> None:
    facts = {
        "processor_seconds": {"trace": 10.0},
        "ray_share_of_tracing": 0.9,
        "ray_spacing_settings": {"ray_spacing": 0.2},
        "statistics": {"rays": 100, "hits": 95},
        "sampling": {"key_pulse_interval": 64, "block_error_db": -30.0},
        "settings": {"gridding_width": 4, "key_pulse_interval": 64},
        "effects": {
            "max_depth": 2,
            "pilot": PILOT,
            "effects": {"wideband": {"on": False, "error_is": "bound", "error_db": bound}},
        },
        "refinement": {},
        "sampling_error": {"VV": {"error_db": -36.0, "source": "two sets"}},
    }
    found = account(replace(image, metadata={**image.metadata, **facts}), {"trace": StageTime(6.0, 10.0)})
    if not advised:  # a loose bound calls for nothing but its measurement
        assert found.finer is None and "`explain --measure` measures them" in found.advice[0]
    else:
        assert found.finer is not None and found.finer.options == f"-D sar_path.{advised}"
        assert found.finer.sum_kind == LAW and str(found.finer).endswith("; law)")
    # twice the blocks would raise what is likely by 2 dB, which the bound must not hide
    assert found.coarser is None or "key_pulse_interval" not in found.coarser.options or bound > -20.0


def test_a_wanted_error_that_is_met_reads_as_met(image: SarImage) -> None:
    facts = {
        "effects": {"effects": {"wideband": {"on": False, "error_is": "at most", "error_db": -28.0}}},
        "sampling_error": {"VV": {"error_db": -36.0, "source": "passes"}},
        "sampling": {"key_pulse_interval": 1},
    }
    for wanted, met in ((-30.0, True), (-37.0, False)):
        metadata = {**image.metadata, **facts, "refinement": {"target_error_db": wanted}}
        found = account(replace(image, metadata=metadata), {})
        assert found.met == met and ("are met" in found.advice[0]) == met
    part = next(p for p in found.parts if p.name == "effects left out")
    assert part.likely_db == -38.0 and str(part).endswith("left out -28.0 dB (likely -38 dB), law")


def witness(error_db: float, law_db: float | None = None, samples: int = 64) -> dict[str, Any]:
    return {
        "error_db": error_db,
        "upper_db": error_db + 1.0,
        "samples": samples,
        "law_db": law_db,
        "reference": "exact",
    }


def test_a_witness_takes_the_place_of_a_law(image: SarImage) -> None:
    focus = {**image.metadata["focus"], "stated_error_db": -58.0, "witness": witness(19.0)}
    found = with_metadata(
        image,
        focus=focus,
        sampling={"key_pulse_interval": 64, "block_error_db": -30.0},
        effects={
            "max_depth": 2,
            "pilot": PILOT,
            "effects": {"wideband": {"on": False, "error_is": "at most", "error_db": -28.0}},
        },
        witnesses={
            "rays": witness(-10.0, law_db=-26.4),
            "blocks": witness(-29.0, law_db=-30.0, samples=8),
            "bounces": witness(-38.0, law_db=-41.5, samples=4),
            "effects": witness(-35.0, samples=2),
        },
    )
    assert [str(part) for part in found.values()][:6] == [
        "rays -10.0 dB, measured here (64), more than the law's -26.4 dB",
        "bounces left out -38.0 dB, measured here (4), more than the law's -41.5 dB",
        "blocks of pulses -29.0 dB, measured here (8)",
        "gridding none",
        "focuser 19.0 dB, measured here (64), more than the law's -58.0 dB",
        "effects left out -35.0 dB, measured here (2)",
    ]
    assert found["focuser"].as_dict() == {
        "error_db": 19.0,
        "known": "measured here",
        "samples": 64,
        "upper_db": 20.0,
        "law_db": -58.0,
        "contradicts": True,
        "why": "exact",
    }
    assert found["effects left out"].law_db == pytest.approx(-28.0)
    junk = with_metadata(image, witnesses=[3], focus={**focus, "witness": {"samples": "many"}})
    assert junk["focuser"].known == LAW


def test_bounces_that_only_a_witness_measured_have_no_change_of_settings(image: SarImage) -> None:
    facts = {
        "effects": {"max_depth": 8, "effects": {"max_depth": {"on": True, "error_is": "at most"}}},
        "witnesses": {"bounces": {**witness(-10.0), "error_db": None, "upper_db": -40.0}},
        "statistics": {"rays": 10, "hits": 40},
    }
    found = account(replace(image, metadata={**image.metadata, **facts}), {})
    (part,) = [part for part in found.parts if part.name == "bounces left out"]
    assert str(part) == "bounces left out none found (95 %: -40.0 dB), measured here (64)"
    assert not [change for change in found.changes if change.cause == part.name]


def test_every_printed_figure_bears_its_kind(image: SarImage) -> None:
    """Of all parts with a level: measured with a number, bound, or law; a sum is what its least certain part is."""
    facts: dict[str, Any] = {
        "sampling_error": {"VV": {"error_db": -36.0, "source": "two sets"}},
        "statistics": {"rays": 7, "key_pulses": 4},
        "sampling": {"key_pulse_interval": 64, "block_error_db": -30.0},
        "effects": {
            "max_depth": 2,
            "pilot": PILOT,
            "effects": {"wideband": {"on": False, "error_is": "at most", "error_db": -28.0}},
        },
    }
    parts = error_budget(replace(image, metadata={**image.metadata, **facts}))
    for part in parts:
        level = math.isfinite(part.error_db)
        assert part.value.split(", ")[-1] in ([part.kind] if level else ["none", UNKNOWN]), part
        assert (part.known == MEASURED and level) == bool(part.samples), part
    found = account(replace(image, metadata={**image.metadata, **facts}), {})
    assert found.kind == LAW and found.as_dict()["known"] == LAW
    found = account(replace(image, metadata={**image.metadata, **facts, "effects": {}}), {})
    assert found.kind == MEASURED
