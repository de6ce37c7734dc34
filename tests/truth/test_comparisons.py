"""Comparisons, the validation page and its plots, on made-up figures."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from sarmitsuba.truth.validation.cases import CASES
from sarmitsuba.truth.validation.comparison import TOPICS, Case, Comparison, summarise
from sarmitsuba.truth.validation.run_cases import plot_case, report, summary_lines


def comparison(offset: float = 0.05, **changes: object) -> Comparison:
    x = np.linspace(0.0, 4.0, 5)
    theory = np.array([10.0, 5.0, -40.0, 0.0, -np.inf])
    simulated = theory + np.array([offset, -offset, 30.0, 2 * offset, 0.0])
    given = {"tolerance": 0.2, "reason": "made up", "floor": 20.0, "canonical": True, **changes}
    return Comparison("curve", x, theory, simulated, **given)  # type: ignore[arg-type]


def case(*comparisons: Comparison) -> Case:
    return Case("made_up", "canonical", "Made up", "x", "nowhere", "x", "y", comparisons, "A note.")


def test_only_points_near_the_peak_are_compared() -> None:
    c = comparison()
    assert c.compared.tolist() == [True, True, False, True, False]
    assert c.worst == pytest.approx(0.1) and c.median == pytest.approx(0.05) and c.passed
    assert c.index == 0
    assert np.isnan(c.deviation[2])
    assert not comparison(floor=60.0).passed  # the null is compared then, and is far off


def test_the_root_mean_square_may_be_judged_with_a_measurement_beside() -> None:
    measured = np.array([10.3, 5.0, 0.0, np.nan, np.nan])
    c = comparison(judged="rms", tolerance=0.08, reference="solver", measured=measured, floor=8.0)
    # of two points
    assert c.rms == c.figure == pytest.approx(0.05) and c.measured_rms == pytest.approx(0.3 / np.sqrt(2.0))
    assert c.passed and np.isnan(comparison().measured_rms)
    bad = replace(c, tolerance=0.04)
    assert not bad.passed and "rms deviation 0.05 dBsm > 0.04" in case(bad).failures()
    page = report([case(c)], "command", {}, "images")
    assert ", rms 0.05 (measurement 0.21) (n = 2)" in page and "| rms 0.08 dB: made up |" in page
    assert "(rms; measurement 0.21)" in summary_lines([case(c)])[0]
    assert not replace(c, simulated=c.simulated * np.nan).passed


def test_a_value_that_is_no_number_never_passes() -> None:
    c = comparison()
    broken = Comparison(c.label, c.x, c.theory, c.simulated * np.nan, 1e9, "")
    assert not broken.passed and broken.worst == np.inf and broken.median == np.inf
    empty = Comparison(c.label, c.x, np.full(5, np.nan), c.simulated, 1e9, "")
    assert not empty.passed


def test_summary_and_page() -> None:
    good, bad = case(comparison()), case(comparison(1.0))
    total = summarise([good, bad])
    assert total.n_points == 6 and total.n_failed == 1 and total.worst == pytest.approx(2.0)
    assert summarise([]).n_points == 0
    page = report([good, bad], "command", {"numpy": "1"}, "images")
    assert "| **Made up**: curve | 10.000 dBsm | 10.050 dBsm |" in page
    assert page.count("**out of tolerance**") == 1
    assert "![Made up](images/made_up.png)" in page and "numpy 1" in page
    assert "FAIL" in summary_lines([bad])[0] and "1 comparisons out of tolerance" in summary_lines([bad])[-1]
    assert good.failures() == "" and "worst deviation 2" in bad.failures()


def test_plot(tmp_path: Path) -> None:
    single = Comparison("one value", np.zeros(1), np.zeros(1), np.array([0.1]), 0.2, "", unit="")
    beside = comparison(measured=np.full(5, 4.0), reference="solver")
    plot_case(
        case(comparison(), single, comparison(floor=np.inf, canonical=False), beside), tmp_path / "a.png"
    )
    assert (tmp_path / "a.png").read_bytes().startswith(b"\x89PNG")


def test_every_case_has_a_known_topic() -> None:
    assert len(CASES.names) > 20
    assert {entry.topic for entry in CASES} == set(TOPICS)


def test_a_topic_of_ones_own_comes_last() -> None:
    own = replace(case(comparison()), name="own", topic="snow", title="Snow")
    page = report([own, case(comparison())], "command", {}, "images")
    assert page.index("## Canonical radar cross sections") < page.index("## Snow") < page.index("### Snow")
