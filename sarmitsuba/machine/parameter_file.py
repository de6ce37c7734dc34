"""parameters.json: record of a run's parameters and results."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from sarmitsuba.machine.atomic import atomic_path
from sarmitsuba.machine.encoding import json_value, to_json
from sarmitsuba.machine.regular_files import read_text


def write(path: Path | str, facts: Mapping[str, object]) -> None:
    """Write the facts as standard JSON (non-finite numbers as text), indented, UTF-8."""
    text = json.dumps(to_json(facts, strict=True), indent=2, ensure_ascii=False, allow_nan=False)
    with atomic_path(path) as temporary:
        temporary.write_text(text + "\n", encoding="utf-8")


def read(path: Path | str) -> dict[str, Any]:
    """Read the facts."""
    facts = json_value(read_text(path, errors="strict"))
    if not isinstance(facts, dict):
        raise ValueError(f"{path}: holds no JSON object")
    return facts
