"""What effects cost stands on its page as a benchmark stored it, nowhere typed by hand."""

import re
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import pytest

from sarmitsuba.effects.effect import effects

DOCS = Path(__file__).parents[2] / "docs"


@pytest.mark.parametrize("study", ["effects", "diffuse_pairs"])
def test_the_page_shows_what_is_stored(benchmark_script: Callable[[str], ModuleType], study: str) -> None:
    stored, made = benchmark_script("stored"), benchmark_script(study)
    page = (DOCS / "effects_measured.md").read_text(encoding="utf-8")
    text = made.markdown(stored.read(study))
    assert text.count("\n|") > 10
    again = f"run: python benchmarks/studies/{study}.py --docs"
    assert stored.filled(page, study, text) == page, again


def test_no_page_types_what_an_effect_costs() -> None:
    """A share of a run, beside the name of an effect or of its option."""
    names = "|".join(effect.name for effect in effects())
    typed = re.compile(r"\d+ % of (?:the|its|a) (?:run|time)|\d+ % of the time of simulating")
    wrong = []
    for path in sorted(DOCS.glob("*.md")):
        text = re.sub(
            r"<!-- (?:generated|benchmark): .*?(?:<!-- end -->|\Z)",
            "",
            path.read_text(encoding="utf-8"),
            flags=re.DOTALL,
        )
        for paragraph in text.split("\n\n"):
            if re.search(rf"`(?:{names})`", paragraph) and typed.search(" ".join(paragraph.split())):
                wrong.append(f"{path.name}: {typed.search(' '.join(paragraph.split()))}")
    assert not wrong, "\n".join(wrong)
