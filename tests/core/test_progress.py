"""How far a run of several stages has come, on a clock of the test's own."""

import random

import pytest

from sarmitsuba.core.progress import Journey


def test_one_share_for_all_stages() -> None:
    now = 0.0
    journey = Journey({"trace": 30.0, "focus": 10.0}, lambda: now)
    assert journey.reached("trace", 0.0).left == float("inf")
    now = 20.0
    half = journey.reached("trace", 0.5)
    assert (half.share, half.elapsed, half.left) == (0.375, 20.0, pytest.approx(20.0 * 25.0 / 15.0))
    assert journey.reached("focus", 0.0).share == 0.75
    assert journey.reached("focus", 1.0).left == 0.0


def test_time_left_is_right_on_a_machine_of_any_speed() -> None:
    """Seconds that are expected in the right proportion: whatever the factor, elapsed and left make up the whole."""
    rng = random.Random(5)
    for _ in range(50):
        expected = {name: rng.uniform(0.1, 50.0) for name in ("plan", "trace", "focus")}
        factor, now = rng.uniform(0.01, 100.0), 0.0
        journey = Journey(expected, lambda: now)  # noqa: B023
        for stage, seconds in expected.items():
            for step in range(1, 6):
                now += 0.2 * factor * seconds
                standing = journey.reached(stage, 0.2 * step)
                # tol: float rounding
                assert standing.elapsed + standing.left == pytest.approx(factor * sum(expected.values()))


def test_a_stage_that_was_not_expected_joins() -> None:
    alone = Journey(clock=lambda: 0.0)
    assert alone.reached("focus", 0.25).share == 0.25
    journey = Journey({"trace": 2.0}, lambda: 0.0)
    assert journey.reached("trace", 1.0).share == 1.0
    assert journey.reached("autofocus", 0.5).share == 0.75
