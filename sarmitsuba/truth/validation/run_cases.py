"""Selection and execution of validation cases: their plots, and a page with summary and table in Markdown."""

from collections.abc import Collection, Mapping, Sequence
from pathlib import Path

import numpy as np

from sarmitsuba.core.errors import OutputError
from sarmitsuba.core.parameters import did_you_mean
from sarmitsuba.machine.atomic import atomic_path
from sarmitsuba.truth.validation.cases import CASES, CaseEntry
from sarmitsuba.truth.validation.comparison import TOPICS, Case, Comparison, summarise
from sarmitsuba.view.charts import DeviationPanel, save_deviation


def select(names: Collection[str] = (), topics: Collection[str] = ()) -> tuple[CaseEntry, ...]:
    """Cases of given names and topics, in the order of the page; all cases if none are given.

    Raises
    ------
    OutputError
        Unknown case or topic.
    """
    entries = tuple(CASES)
    known = {entry.topic for entry in entries}
    for name in names:
        if name not in CASES:
            guess = did_you_mean(name, CASES.names)
            raise OutputError(
                f"validate: there is no case {name!r}{guess}; `validate --list` shows all cases"
            )
    for topic in topics:
        if topic not in known:
            guess = did_you_mean(topic, known)
            raise OutputError(
                f"validate: there is no topic {topic!r}{guess}; `validate --list` shows all topics"
            )
    order = [*TOPICS, *sorted(known - set(TOPICS))]
    chosen = [e for e in entries if not (names or topics) or e.name in names or e.topic in topics]
    return tuple(sorted(chosen, key=lambda entry: order.index(entry.topic)))


def run_case(entry: CaseEntry, quick: bool = False) -> Case:
    """Run one case; ``quick``: with fewer bands, angles and looks, as in the tests.

    Raises
    ------
    OutputError
        The names of the case and of its entry differ, so that page and plots would not match.
    """
    case = entry.build(quick)
    if (case.name, case.topic) != (entry.name, entry.topic):
        raise OutputError(
            f"validate: case {entry.name!r} of topic {entry.topic!r} returned {case.name!r} of {case.topic!r}"
        )
    return case


def plot_case(case: Case, path: Path) -> None:
    """Write the plot of a case as PNG; one panel per comparison, curve above and deviation below."""
    panels = [_panel(c) for c in case.comparisons]
    save_deviation(panels, path, title=case.title, x_label=case.x_label, y_label=case.y_label)


def _panel(c: Comparison) -> DeviationPanel:
    compared = c.compared
    in_db = c.unit in ("dBsm", "dB")
    return DeviationPanel(
        title=c.label,
        x=c.x,
        reference=c.theory,
        measured=c.simulated,
        compared=compared,
        tolerance=c.tolerance,
        reference_name=c.reference,
        beside=c.measured if c.measured is not None and np.isfinite(c.measured).any() else None,
        depth=c.drawn or (c.floor if in_db and np.isfinite(c.floor) and compared.any() else None),
    )


LIMITS = """## What the closed forms leave out, and so does the simulator

- Diffraction, surface and creeping waves: physical optics and geometrical optics, both here and there. The
  exceptions are the cases of edges, which hold physical optics and fringe currents to exact wedges, the sphere,
  which is also compared with the exact Mie series, the three scenes of 6 wavelengths whose exact scattering is
  stored, and the bodies that were measured. They show where physical optics ends. Glints and double bounces of
  flat parts hold. A box off its glints, where edges and corners are all there is, returns far more than physical
  optics; what its edges add is in `docs/effects.md`. Between
  plates VV is worse than HH. Between curved and flat metal a wavelength or two apart the mean power holds, single
  directions do not. The cross-polar return of metal with flat faces is an artefact of physical optics, not theirs.
- Three diffuse scatterers in a row, and a diffuse scatterer seen out through one chain of mirrors and back through
  another longer one (the five-bounce return of a bridge).
- Roughness that casts shadows on itself, and multiple scattering on one rough surface or within one crown.
"""


def report(cases: Sequence[Case], command: str, facts: Mapping[str, str], images: str) -> str:
    """Return the page.

    Parameters
    ----------
    cases : finished cases, in the order of the page
    command : that made the page
    facts : versions and seeds to print
    images : folder of the plots, relative to the page
    """
    total = summarise(cases)
    lines = [
        "# Validation",
        "",
        f"Made by `{command}`; every figure below comes out of that run.",
        "",
        "Every case compares the simulator with a closed form, a published value, an exact solution, or what the "
        "scene was given. "
        "The same cases, some of them with fewer bands and angles, are the tests in `tests/truth` and "
        "`tests/statistics`.",
        "",
        f"**Canonical radar cross sections: median deviation {total.median:.4f} dB, worst {total.worst:.4f} dB** over "
        f"{total.n_points} angles, frequencies and polarisations in {total.n_comparisons} comparisons. "
        f"Comparisons of all topics out of tolerance: {total.n_failed}.",
        "",
        "*Deviation* is simulated minus closed form at every compared point: `median / worst` of its modulus. "
        "Patterns are compared where the closed form lies within a stated distance of its peak, which the note below "
        "each case gives: in nulls a ratio in dB means nothing. The values quoted are those at the peak of the "
        "closed form or at the place that the note names.",
        "",
    ]
    if facts:
        lines += [", ".join(f"{name} {value}" for name, value in facts.items()) + ".", ""]
    given = dict.fromkeys(case.topic for case in cases)
    for topic in [*(t for t in TOPICS if t in given), *(t for t in given if t not in TOPICS)]:
        members = [case for case in cases if case.topic == topic]
        lines += [f"## {TOPICS.get(topic, topic.capitalize())}", "", *_table(members), ""]
        for case in members:
            lines += [
                f"### {case.title}",
                "",
                f"`{case.formula}`",
                "",
                f"Source: {case.source}. {case.note}",
                "",
                f"![{case.title}]({images}/{case.name}.png)",
                "",
            ]
    return "\n".join([*lines, LIMITS])


def _table(cases: Sequence[Case]) -> list[str]:
    rows = [
        "| case | closed form | simulated | deviation, median / worst | tolerance and its reason |",
        "|---|---|---|---|---|",
    ]
    for case in cases:
        for i, c in enumerate(case.comparisons):
            name = f"**{case.title}**: {c.label}" if i == 0 else c.label
            unit = f" {c.unit}" if c.unit else ""
            ratio = " dB" if c.unit == "dBsm" else unit
            mark = "" if c.passed else " **out of tolerance**"
            third = f"{_short(c.median)} / {_short(c.worst)}{ratio}"
            if c.judged == "rms":
                third += f", rms {_short(c.rms)}"
                beside = [f"measurement {_short(c.measured_rms)}"] if np.isfinite(c.measured_rms) else []
                beside += [f"stated {_short(c.stated)}"] if not np.isnan(c.stated) else []
                third += f" ({', '.join(beside)})" if beside else ""
            bound = "rms " if c.judged == "rms" else ""
            rows.append(
                f"| {name} | {_quote(c, c.theory)}{unit} | {_quote(c, c.simulated)}{unit} | "
                f"{third} (n = {int(c.compared.sum())}){mark} | "
                f"{bound}{_short(c.tolerance)}{ratio}: {c.reason} |"
            )
    return rows


def _quote(c: Comparison, values: object) -> str:
    value = float(np.asarray(values)[c.index])
    return f"{value:.3f}" if abs(value) >= 0.01 or value == 0.0 else f"{value:.2e}"


def _short(value: float) -> str:
    if value == 0.0:
        return "0"
    return f"{value:.2g}" if 1e-3 <= abs(value) < 1e3 else f"{value:.0e}"


def summary_lines(cases: Sequence[Case]) -> list[str]:
    """One line per comparison for the terminal, and the summary last."""
    lines = []
    for case in cases:
        for c in case.comparisons:
            state = "ok  " if c.passed else "FAIL"
            lines.append(
                f"{state} {case.name:<20} {c.label:<58} {_quote(c, c.theory):>10} {_quote(c, c.simulated):>10} "
                f"{_short(c.median):>8} {_short(c.figure):>8} {_short(c.tolerance):>8} {c.unit}"
                + (f" (rms; measurement {_short(c.measured_rms)}" if c.judged == "rms" else "")
                + (f"; stated {_short(c.stated)}" if not np.isnan(c.stated) else "")
                + (")" if c.judged == "rms" else "")
            )
    total = summarise(cases)
    canonical = (
        f"canonical radar cross sections: median deviation {total.median:.4f} dB, worst {total.worst:.4f} dB, "
        f"{total.n_points} points; "
    )
    lines.append(f"{canonical if total.n_points else ''}{total.n_failed} comparisons out of tolerance")
    return lines


def write(path: Path, text: str) -> None:
    """Write the page in one step."""
    with atomic_path(path) as temporary:
        temporary.write_text(text, encoding="utf-8")
