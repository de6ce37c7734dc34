"""Errors measured in a run on a drawn sample."""

import math

import numpy as np

from sarmitsuba.core.witness import Witness


def test_level_of_a_drawn_sample_and_its_confidence() -> None:
    """5 % of the samples of a known error lie above the upper level, within the scatter of 200 trials."""
    generator = np.random.default_rng(4)
    above = 0
    for trial in range(200):
        error = 1e-3 * generator.exponential(size=64)
        found = Witness.from_weighted(error, np.array([64.0]), trial)
        above += found.upper_db < -30.0
        assert abs(found.error_db + 30.0) < 3.0  # tol: 64 exponential values scatter by 0.54 dB
    assert (
        above < 25
    )  # tol: 10 expected, standard deviation 3.1, and the bootstrap of a skewed law is a little low


def test_law_is_contradicted_and_results_of_no_use_are_named() -> None:
    poor = Witness.from_weighted(np.ones(8), np.ones(8), 1, law_db=-58.0, reference="exact backprojection")
    assert poor.contradicts and poor.useless and poor.error_db == 0.0
    good = Witness.from_weighted(1e-6 * np.ones(8), np.ones(8), 1, law_db=-58.0)
    assert not good.contradicts and not good.useless
    none = Witness.from_weighted(np.zeros(8), np.ones(8), 1)
    assert none.error_db == -math.inf and not none.contradicts and not none.useless
    dark = Witness.from_weighted(np.ones(8), np.zeros(8), 1)
    assert dark.useless


def test_a_witness_outlives_its_file() -> None:
    found = Witness(-42.25, -40.5, 64, -58.0, "exact backprojection")
    assert Witness.read(found.as_dict()) == found
    assert Witness.read({"samples": "many"}) is None and Witness.read(7) is None
