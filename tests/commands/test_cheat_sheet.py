"""Every command of the cheat sheet is one that the program takes."""

import re
import shlex
from pathlib import Path

import pytest

from sarmitsuba import cli
from sarmitsuba.loading.load import load_scene

PAGE = Path(__file__).parents[2] / "docs" / "quickstart.md"
SHEET = PAGE.read_text(encoding="utf-8").partition("\n## Cheat sheet\n")[2].partition("\n## ")[0]
COMMANDS = [
    command
    for row in re.findall(r"^\| [^|]+ \| (.+) \|$", SHEET, re.MULTILINE)
    for command in re.findall(r"`([a-z]+(?: [^`]+)?)`", row)
    if "/" not in command.split()[0]
]


def test_there_are_many_and_each_begins_with_a_command() -> None:
    assert len(COMMANDS) >= 30 and len(set(COMMANDS)) >= len(COMMANDS) - 1


@pytest.mark.parametrize("command", sorted(set(COMMANDS)))
def test_the_program_takes_it(command: str) -> None:
    words = ["tower" if word == "S" else word for word in shlex.split(command)]
    arguments = cli.build_parser().parse_args(words)
    if "tower" in words:  # the values that it sets are values of the scene
        load_scene("tower", parameters=dict(getattr(arguments, "define", ())))
