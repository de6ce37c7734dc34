"""The validation page's cases, in their quick form: every canonical target, material and image is tested here, once."""

import pytest

from sarmitsuba.core.errors import OutputError
from sarmitsuba.truth.validation.cases import CASES, CaseEntry
from sarmitsuba.truth.validation.cases.plates import plate
from sarmitsuba.truth.validation.cases.tessellation import tessellation
from sarmitsuba.truth.validation.comparison import summarise
from sarmitsuba.truth.validation.run_cases import run_case, select

# images of a minute and more
SLOW = {"building", "bridge", "ground_sigma0", "ground_rays"}
# of seconds, and a second look at what tests of their own hold: test_importing, test_orbit_targets, test_moving,
# test_bistatic_simulation, test_reciprocity, test_cavities
SLOW |= {"imported_city", "orbit_points", "moving_smear", "moving_displacement", "along_track_phase"}
SLOW |= {"cross_polar_reciprocity", "double_glazing", "trunk_ground", "bistatic_plate", "crown_ground"}
# the same: test_diffuse_laws, test_edge_diffraction, test_link, test_volumes, test_compact_polarimetry, test_chain,
# test_look_modes, test_slabs, test_rcs_sweep, test_interferometry
SLOW |= {"diffuse_laws", "edge_wedges", "link", "canopies", "polarimetric_targets", "point_rcs"}
SLOW |= {"beam_gain", "corner_behind_pane", "traced_rcs", "sphere", "roof_height"}
# the prism is a body of that topic, too
SLOW |= {f"measured_{name}" for name in ("plate", "thick_plate", "dielectric_plate", "almond", "duct")}


def marks(entry: CaseEntry) -> list[pytest.MarkDecorator]:
    return [pytest.mark.slow] if entry.name in SLOW else []


# those of the topic "statistics" share one image and are in tests/statistics
@pytest.mark.filterwarnings("ignore::sarmitsuba.core.errors.SarmitsubaWarning")  # rays chosen by the case
@pytest.mark.parametrize(
    "entry",
    [pytest.param(e, marks=marks(e)) for e in CASES if e.topic != "statistics"],
    ids=lambda e: e.name,
)
def test_case(entry: CaseEntry) -> None:
    """Every comparison within its own tolerance, whose reason the case states."""
    case = run_case(entry, quick=True)
    assert case.passed, case.failures()


@pytest.mark.slow
def test_all_bands() -> None:
    """L, C, X and Ka: median deviation below 0.1 dB, worst below 0.3 dB where the closed forms hold."""
    cases = [run_case(entry) for entry in select(topics=["canonical"])]
    total = summarise(cases)
    assert not [case.failures() for case in cases if not case.passed]
    assert total.median < 0.1  # asked for
    assert total.worst < 0.3  # asked for
    assert total.n_points > 2000


def test_the_summary_counts_what_it_says() -> None:
    case = tessellation(True)
    assert summarise([case]).n_points == 0  # compared with itself: not canonical
    canonical = plate(True)
    total = summarise([canonical])
    compared = [c.compared for c in canonical.comparisons]
    assert total.n_points == sum(int(c.sum()) for c in compared)
    assert all(0.2 < c.mean() < 1.0 for c in compared)  # nulls are left out, lobes are not
    assert total.worst == pytest.approx(max(c.worst for c in canonical.comparisons))
    # the floor lets the peaks of three sidelobes through: -13.3, -17.8 and -20.8 dB
    y = canonical.comparisons[0].theory
    peaks = [i for i in range(1, y.size - 1) if y[i] > y[i - 1] and y[i] > y[i + 1]]
    assert len(peaks) == 3 and canonical.comparisons[0].compared[peaks].all()


def test_cases_are_chosen_by_name_and_topic() -> None:
    clutter = {"speckle", "correlation", "looks", "k_distribution", "gamma_texture"}
    assert {e.name for e in select(["plate"], ["statistics"])} == {"plate", *clutter}
    assert len(select()) == len(CASES.names)
    with pytest.raises(OutputError, match="no case 'plat'"):
        select(["plat"])
    with pytest.raises(OutputError, match="no topic 'x'"):
        select(topics=["x"])


def test_a_case_that_calls_itself_otherwise_is_refused() -> None:
    with pytest.raises(OutputError, match="returned 'tessellation'"):
        run_case(CaseEntry("triangles", "canonical", tessellation), quick=True)
