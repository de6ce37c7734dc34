"""Selection and execution of validation cases."""

from collections.abc import Collection

from sarmitsuba.core.errors import OutputError
from sarmitsuba.truth.validation.cases import CASES, CaseEntry
from sarmitsuba.truth.validation.comparison import TOPICS, Case


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
            raise OutputError(f"validate: there is no case {name!r}; `validate --list` shows all cases")
    for topic in topics:
        if topic not in known:
            raise OutputError(f"validate: there is no topic {topic!r}; `validate --list` shows all topics")
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
