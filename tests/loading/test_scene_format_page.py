import re
from pathlib import Path

import pytest

from sarmitsuba.loading.format_doc import fill_tables
from sarmitsuba.loading.load import load_scene
from sarmitsuba.loading.tables import TABLES
from sarmitsuba.scene.scatterers import SCATTERERS

DOCS = Path(__file__).parents[2] / "docs"
PAGE = DOCS / "scene_format.md"
GUIDE = DOCS / "scenes.md"


@pytest.mark.parametrize("name", ["scene_format.md", "effects.md"])
def test_the_page_is_up_to_date(name: str) -> None:
    text = (DOCS / name).read_text(encoding="utf-8")
    assert "<!-- table: " in text
    assert fill_tables(text) == text, f"run: python -m sarmitsuba.loading.format_doc docs/{name}"


def test_the_page_holds_every_plugin() -> None:
    text = PAGE.read_text(encoding="utf-8")
    assert set(re.findall(r"<!-- table: ([\w-]+) -->", text)) == {
        *TABLES,
        *SCATTERERS.own_names,
        "laws",
        "modes",
        "itu",
        "bsdfs",
        "shapes",
    }


def test_the_smallest_scene_of_the_guide_loads(tmp_path: Path) -> None:
    example = re.search(r"```xml\n(.*?)```", GUIDE.read_text(encoding="utf-8"), re.DOTALL)
    assert example is not None
    path = tmp_path / "scene.xml"
    path.write_text(example[1], encoding="utf-8")
    assert load_scene(path).materials[0].name == "radar_material_1"
