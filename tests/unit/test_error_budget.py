"""Errors of an image by their cause, as metadata give them."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import sarmitsuba
from sarmitsuba.analysis.quality.error_budget import AT_MOST, MEASURED, UNKNOWN, error_budget
from sarmitsuba.echo.gridding import gridding_kernel
from sarmitsuba.image.sar_image import SarImage

PILOT = {"energy_from_order_upper_db": [0.0, -12.5, -41.5, None]}


@pytest.fixture(scope="module")
def image() -> SarImage:
    return sarmitsuba.focus(sarmitsuba.simulate(sarmitsuba.load_scene("point"), seed=1))


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
        "physical optics",
    ]
    assert parts["bounces left out"].error_db == parts["blocks of pulses"].error_db == -math.inf
    assert parts["rays"].error_db == -math.inf and parts["rays"].why == "nothing is traced"
    assert parts["gridding"].error_db == pytest.approx(gridding_kernel(4).error_db + 3.01, abs=0.01)
    assert parts["focuser"].known == AT_MOST and parts["focuser"].error_db < -50.0
    assert parts["physical optics"].known == UNKNOWN
    assert str(parts["bounces left out"]) == "bounces left out none"


@pytest.mark.parametrize(
    ("depth", "text"),
    [
        (1, "bounces left out at most -12.5 dB"),
        (2, "bounces left out at most -41.5 dB"),
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
