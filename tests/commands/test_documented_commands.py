"""Every command line in the documentation is one that the program takes."""

import argparse
import re
import shlex
from pathlib import Path

import pytest

from sarmitsuba.cli import build_parser
from sarmitsuba.loading.library import list_scenes
from sarmitsuba.truth.validation.cases import CASES

ROOT = Path(__file__).parents[2]
PAGES = sorted(ROOT.glob("docs/*.md"))


def commands(page: Path) -> list[list[str]]:
    """Words of the lines that run the program, but for those with names of extensions or of the shell."""
    text = page.read_text(encoding="utf-8").replace("\\\n", " ")
    lines = re.findall(r"^(?:    )?python -m sarmitsuba (.*)$", text, re.MULTILINE)
    words = [shlex.split(line, comments=True) for line in lines]
    return [w for w in words if "--extension" not in w and not any(c in word for word in w for c in "$|<")]


def test_documented_commands_are_taken(capsys: pytest.CaptureFixture[str]) -> None:
    parser = build_parser()
    shipped = {entry.name for entry in list_scenes()}
    cases = {entry.name for entry in CASES}
    found = [(page.name, words) for page in PAGES for words in commands(page)]
    assert len(found) > 80
    wrong = []
    for page, words in found:
        try:
            args = parser.parse_args(words)
        except SystemExit:
            wrong.append(f"{page}: {shlex.join(words)}: {capsys.readouterr().err.strip()}")
            continue
        scene = str(getattr(args, "scene", ""))
        if re.fullmatch(r"[a-z0-9_]+", scene) and scene not in shipped:
            wrong.append(f"{page}: no scene {scene}")
        wrong += [
            f"{page}: no case {case}" for case in getattr(args, "case", None) or () if case not in cases
        ]
    assert not wrong, "\n".join(wrong)


def test_table_of_options_is_that_of_the_parser() -> None:
    """Options of every command in docs/running.md, against those that the program takes: none more, none less."""
    parser = build_parser()
    commands_of = next(
        action.choices for action in parser._actions if isinstance(action, argparse._SubParsersAction)
    )
    taken = {
        (name, option)
        for name, command in commands_of.items()
        for action in command._actions
        for option in action.option_strings[-1:]  # the long one; of a switch with its opposite, that
    }
    page = (ROOT / "docs" / "running.md").read_text(encoding="utf-8")
    listed = re.search(r"^Scene commands are (.+?)\. ", page, re.MULTILINE)
    assert listed
    page = page.replace("| scene commands", f"| {listed[1]}")
    rows = [
        [re.findall(r"`([^`]+)`", cell) for cell in line.split(" | ")[:2]]
        for line in page.splitlines()
        if line.startswith("| `--")
    ]
    documented = [
        (name, option) for options, names in rows for name in names or commands_of for option in options
    ]
    assert len(set(documented)) == len(documented) > 150
    assert set(documented) == taken
