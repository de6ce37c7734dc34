"""The command dataset: the same bits however samples are made, after a kill too; failing draws; refusals."""

import json
import re
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import Any

import h5py
import numpy as np
import pytest

from sarmitsuba import cli
from sarmitsuba.apps import dataset_generate as generate
from sarmitsuba.apps import dataset_sample as sample
from sarmitsuba.apps.dataset_draw import Drawer, DrawnSample
from sarmitsuba.core.errors import OutputError, RadarError, ResourceError
from sarmitsuba.loading.library import scenes_dir

RECIPE = """
[dataset]
samples = 5
seed = 11
error_every = 4
licence = "CC0-1.0"
[images]
pixels_azimuth = 40
pixels_range = 32
tile_azimuth = 24
overlap = 6
[output]
pictures = true
[objects]
heading_deg = {{ uniform = [0, 360] }}
[ground]
material = "asphalt"
[radar]
look_angle_deg = {{ uniform = [40, 50] }}
bandwidth = 200e6
azimuth_resolution = 1.0
[tracing]
method = "{method}"
"""


@pytest.fixture
def recipe(tmp_path: Path) -> Path:
    path = tmp_path / "small.toml"
    path.write_text(RECIPE.format(method="image"), encoding="utf-8")
    return path


def content(folder: Path) -> dict[str, bytes]:
    """Files of a data set but the card, whose text names seconds nowhere either."""
    return {p.name: p.read_bytes() for p in folder.iterdir() if p.name != ".sarmitsuba.json"}


def made(recipe: Path, out: Path, *more: str) -> dict[str, bytes]:
    assert cli.main(["dataset", str(recipe), "-o", str(out), "--quiet", *more]) == 0
    return content(out)


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The data set of the recipe, made by one process."""
    folder = tmp_path_factory.mktemp("whole")
    path = folder / "small.toml"
    path.write_text(RECIPE.format(method="image"), encoding="utf-8")
    made(path, folder / "out", "--jobs", "1")
    return folder / "out"


def test_two_processes_give_the_same_bits(whole: Path, recipe: Path, tmp_path: Path) -> None:
    assert made(recipe, tmp_path / "out", "--jobs", "2") == content(whole)


def test_a_sample_alone_has_the_bits_of_the_whole(whole: Path, recipe: Path, tmp_path: Path) -> None:
    made(recipe, tmp_path / "out", "--sample", "3", "--sample", "1")
    with h5py.File(whole / "dataset.h5") as file, h5py.File(tmp_path / "out" / "dataset.h5") as few:
        rows = np.isin(file["rows/sample"][()], [1, 3])
        assert rows.sum() == 4  # two tiles each
        assert np.array_equal(few["images"][()], file["images"][()][rows])
        for name in file["drawn"]:
            assert np.array_equal(few[f"drawn/{name}"][()], file[f"drawn/{name}"][()][rows])


KILLED = """
import os, signal, sys
from sarmitsuba import cli
from sarmitsuba.apps import dataset_generate as generate
append = generate.append
def then_end(journal, sample):
    size = append(journal, sample)
    if len(journal.labels) == 2:
        os.kill(os.getpid(), signal.SIGKILL)
    return size
generate.append = then_end
cli.main(sys.argv[1:])
"""


@pytest.mark.slow
def test_a_killed_run_goes_on_with_the_same_bits(
    whole: Path, recipe: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "out"
    argv = ["dataset", str(recipe), "-o", str(out), "--quiet", "--jobs", "2"]
    killed = subprocess.run([sys.executable, "-c", KILLED, *argv], capture_output=True, text=True)
    assert killed.returncode == -signal.SIGKILL
    assert killed.stderr == ""  # until the last process has ended; nothing of theirs is left in the system
    assert {p.name for p in out.iterdir() if p.suffix != ".png"} == {"samples.journal", ".sarmitsuba.json"}
    numbers: list[int] = []
    monkeypatch.setattr(
        generate, "make_sample", lambda drawer, n: numbers.append(n) or sample.make_sample(drawer, n)
    )
    assert made(recipe, out, "--jobs", "1") == content(whole)
    assert len(numbers) == 3  # finished ones are not made again


def test_a_finished_data_set_is_left_alone(whole: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(generate, "make_sample", lambda *_: pytest.fail("made again"))
    before = content(whole)
    assert made(whole.parent / "small.toml", whole) == before


def test_another_recipe_does_not_replace_it(
    whole: Path, recipe: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    recipe.write_text(recipe.read_text().replace("seed = 11", "seed = 12"))
    assert cli.main(["dataset", str(recipe), "-o", str(whole)]) == 2
    assert "--force" in capsys.readouterr().err


def test_tiles_rows_and_parts(whole: Path) -> None:
    with h5py.File(whole / "dataset.h5") as file:
        assert file["images"].shape == (10, 1, 24, 32)
        first, second = file["images"][0], file["images"][1]
        assert file["rows/first_row"][:2].tolist() == [0, 16]
        # rows that both tiles hold
        assert np.array_equal(first[:, 16:], second[:, :8])
        assert np.isfinite(file["images"][()]).all()
        codes, classes = file["rows/target_class"][()], list(file.attrs["classes"])
        assert [classes[c] for c in codes] == [
            n.decode().split("/")[0] for n in file["rows/target_instance"][()]
        ]
        boxes, rows = file["objects/box"][()], file["objects/row"][()]
        # the same shape in both tiles, in the pixels of each
        assert np.allclose(boxes[rows == 0] - boxes[rows == 1], [[16.0, 0.0, 16.0, 0.0]])
        for name in ("images", "rows/part", "objects/box", "drawn/radar.look_angle_deg"):
            assert file[name].attrs["description"]


def test_the_echo_lies_in_its_box(whole: Path) -> None:
    """The brightest pixel of a body on soil lies in the bounds of its vertices, and two resolution cells around."""
    with h5py.File(whole / "dataset.h5") as file:
        cell = file["drawn/image.azimuth_resolution_cell"][0] / file["drawn/image.azimuth_spacing"][0]
        inside = 0
        for row in range(0, 10, 2):
            power = np.abs(np.concatenate([file["images"][row][0, :16], file["images"][row + 1][0]]))
            peak = np.array(np.unravel_index(power.argmax(), power.shape))
            low, high = file["objects/box"][()][file["objects/row"][()] == row][0].reshape(2, 2)
            inside += bool((peak >= low - 2.0 * cell).all() and (peak <= high + 2.0 * cell).all())
    assert inside == 5


def test_the_card_says_what_was_drawn(whole: Path) -> None:
    text = (whole / "datacard.md").read_text(encoding="utf-8")
    for words in (
        "seed: 11",
        "CC0-1.0",
        "radar.look_angle_deg",
        "uniform from 40 to 50",
        "sampling error",
        "## Physics",
    ):
        assert words in text
    assert "sampling error, dB**: mean -" in text  # measured on samples 0 and 4


def test_coco_documents_are_consistent(whole: Path) -> None:
    images: list[int] = []
    for part in ("train", "validation", "test"):
        document: dict[str, Any] = json.loads((whole / f"annotations_{part}.json").read_text())
        known = {image["id"]: image for image in document["images"]}
        images += list(known)
        for image in document["images"]:
            assert (whole / image["file_name"]).is_file()
        categories = {c["id"] for c in document["categories"]}
        for one in document["annotations"]:
            x, y, width, height = one["bbox"]
            image = known[one["image_id"]]
            assert one["category_id"] in categories and width > 0 and height > 0
            assert x >= 0 and y >= 0 and x + width <= image["width"] and y + height <= image["height"]
    assert sorted(images) == list(range(10))


class FakeTorch(ModuleType):
    """The names of torch that the page's ten lines use."""

    log, from_numpy = staticmethod(np.log), staticmethod(np.asarray)
    utils = type("utils", (), {"data": type("data", (), {"Dataset": object})})


def test_the_ten_lines_of_the_page_read_it(whole: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    page = (Path(__file__).parents[2] / "docs" / "labels.md").read_text(encoding="utf-8")
    (code,) = re.findall(r"```python\n(import h5py.*?)```", page, re.DOTALL)
    monkeypatch.setitem(sys.modules, "torch", FakeTorch("torch"))
    names: dict[str, Any] = {}
    exec(code, names)
    with h5py.File(whole / "dataset.h5") as file:
        part = file["rows/part"][()]
        classes = file["rows/target_class"][()]
        images = file["images"][()]
        parts = list(file.attrs["parts"])
    total = 0
    for i, name in enumerate(parts):
        chips = names["Chips"](whole / "dataset.h5", name)
        rows = np.flatnonzero(part == i)
        assert len(chips) == rows.size
        total += len(chips)
        for k, row in enumerate(rows):
            values, kind = chips[k]
            np.testing.assert_allclose(
                np.exp(values), np.abs(images[row]) ** 2 + 1e-6, rtol=1e-4
            )  # tol: float32
            assert kind == classes[row]
    assert total == 10


@pytest.fixture
def failing(monkeypatch: pytest.MonkeyPatch) -> Iterator[dict[tuple[int, int], Exception]]:
    """Draws (number, attempt) that raise."""
    wrong: dict[tuple[int, int], Exception] = {}
    draw = Drawer.draw

    def drawn(self: Drawer, number: int, attempt: int) -> DrawnSample:
        if (number, attempt) in wrong:
            raise wrong[number, attempt]
        return draw(self, number, attempt)

    monkeypatch.setattr(Drawer, "draw", drawn)
    yield wrong


def test_a_failing_draw_is_recorded_and_replaced(
    failing: dict[tuple[int, int], Exception], recipe: Path, tmp_path: Path
) -> None:
    failing[1, 0] = failing[1, 1] = RadarError("the beam misses the scene")
    made(recipe, tmp_path / "out", "--sample", "0", "--sample", "1", "--jobs", "1")
    with h5py.File(tmp_path / "out" / "dataset.h5") as file:
        assert file["rows/sample"][()].tolist() == [0, 0, 1, 1]
    card = (tmp_path / "out" / "datacard.md").read_text(encoding="utf-8")
    assert "2 draws failed and were replaced" in card and "the beam misses the scene" in card


def test_an_image_of_nan_is_a_failing_draw(recipe: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    execute, calls = sample.execute, []

    def broken(*args: Any, **named: Any) -> Any:
        done = execute(*args, **named)
        calls.append(1)
        image = replace(done.image, data=done.image.data * np.float32("nan"))
        return replace(done, image=image) if len(calls) == 1 else done

    monkeypatch.setattr(sample, "execute", broken)
    made_one = sample.make_sample(Drawer.of(str(recipe)), 1)
    assert made_one.attempt == 1 and "not finite" in made_one.failures[0]


@pytest.mark.parametrize(
    ("error", "said"),
    [
        (ResourceError("needs 9 TB of memory, and 1 GB are free"), "needs 9 TB"),
        (MemoryError(), "memory of the"),
    ],
)
def test_a_draw_too_large_for_the_memory_is_replaced(
    failing: dict[tuple[int, int], Exception], recipe: Path, error: Exception, said: str
) -> None:
    failing[2, 0] = error
    made_one = sample.make_sample(Drawer.of(str(recipe)), 2)
    assert made_one.attempt == 1 and len(made_one.failures) == 1 and said in made_one.failures[0]


def test_errors_of_the_machine_end_the_run(
    failing: dict[tuple[int, int], Exception],
    recipe: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    failing[0, 0] = OutputError("the disk is full")
    assert cli.main(["dataset", str(recipe), "-o", str(tmp_path / "out"), "--jobs", "1"]) == 2
    assert capsys.readouterr().err.count("error:") == 1


def test_a_recipe_whose_draws_all_fail_ends_with_its_reason(
    recipe: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    recipe.write_text(recipe.read_text().replace("[objects]", "[objects]\ncount = 20\nspread = 3.0"))
    assert cli.main(["dataset", str(recipe), "-o", str(tmp_path / "out"), "--jobs", "1", "--quiet"]) == 2
    line = capsys.readouterr().err.strip()
    assert "sample 0: 20 draws failed" in line and "no free place" in line and "\n" not in line


@pytest.mark.parametrize(
    ("change", "argv", "said"),
    [
        (("[output]\npictures = true", "[output]"), [], "TB are free"),
        (("samples = 5", "samples = 5"), ["--sample", "5"], "there is no sample 5; give 0 to 4"),
        (("[objects]", '[objects]\nmeshes = "tragets"'), [], 'did you mean "targets"?'),
        (("samples = 5", "samples = 5"), ["--jobs", "-1"], "--jobs -1 is not from 0 to 4096"),
    ],
)
def test_refusals_come_before_any_sample(
    change: tuple[str, str],
    argv: list[str],
    said: str,
    recipe: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(generate, "make_sample", lambda *_: pytest.fail("made a sample"))
    monkeypatch.setattr("shutil.disk_usage", lambda _: type("Use", (), {"free": 1e4})())
    said = said.replace("TB are free", "1e-05 GB are free")
    recipe.write_text(recipe.read_text().replace(*change))
    assert cli.main(["dataset", str(recipe), "-o", str(tmp_path / "out"), *argv]) == 2
    line = capsys.readouterr().err.strip()
    assert said in line and "\n" not in line
    assert not (tmp_path / "out").exists()


def test_raw_data_on_request(recipe: Path, tmp_path: Path) -> None:
    from sarmitsuba import focus, read_raw

    text = RECIPE.format(method="hybrid").replace("pictures = true", "raw = true")
    recipe.write_text(text)
    made(recipe, tmp_path / "out", "--sample", "2", "--jobs", "1")
    image = focus(read_raw(tmp_path / "out" / "raw_0000002.h5")).total()
    with h5py.File(tmp_path / "out" / "dataset.h5") as file:
        stored = np.concatenate([file["images"][0][0, :16], file["images"][1][0]])
    # tol: focusing by several threads adds in another order, float32
    assert np.abs(stored - image).max() < 1e-5 * np.abs(image).max()


def test_scene_files_are_seen_under_drawn_radars(tmp_path: Path) -> None:
    path = tmp_path / "towers.toml"
    path.write_text(
        "[dataset]\nsamples = 2\n[images]\npixels_azimuth = 32\npixels_range = 32\n[scene]\n"
        "file = { choice = ['trihedral', 'dihedral'] }\n[radar]\nlook_angle_deg = { uniform = [42, 48] }\n"
        "[tracing]\nmethod = 'image'\n"
    )
    made(path, tmp_path / "out", "--jobs", "1")
    with h5py.File(tmp_path / "out" / "dataset.h5") as file:
        assert set(file["drawn/scene.file"].asstr()[()]) <= {"trihedral", "dihedral"}
        assert (file["drawn/radar.look_angle_deg"][()] >= 42.0).all() and file["images"].shape == (
            2,
            2,
            32,
            32,
        )
        assert file["rows/channels"].asstr()[()].tolist() == ["HH,VV"] * 2


def test_shapes_of_scene_files_are_named_and_annotated_by_class(tmp_path: Path) -> None:
    path, out = tmp_path / "places.toml", tmp_path / "out"
    path.write_text(
        "[dataset]\nsamples = 4\nseed = 1\n[images]\npixels_azimuth = 40\npixels_range = 40\n[scene]\n"
        "file = { choice = ['trihedral', 'buildings16'] }\n[film]\npixel_spacing_azimuth = 2.0\n"
        "pixel_spacing_range = 2.0\n[labels]\nlayers = 'shape, layover_shadow'\n[classes]\n"
        "'build*' = 'building'\nground = 'soil'\n[radar]\npolarisation = 'VV'\n[tracing]\nmethod = 'raster'\n"
    )
    made(path, out, "--jobs", "1")
    with h5py.File(out / "dataset.h5") as file:
        files = file["drawn/scene.file"].asstr()[()]
        assert set(files) == {"trihedral", "buildings16"}
        assert list(file.attrs["classes"]) == ["building", "soil"]
        masks, rows = file["labels/shape"][()], file["rows/sample"][()]
        columns = [file["shapes/sample"][()], file["shapes/code"][()]]
        texts = [file[f"shapes/{name}"].asstr()[()] for name in ("name", "class")]
        table = {(s, n): (c, kind) for s, c, n, kind in zip(*columns, *texts, strict=True)}
        assert list(file["labels/layover_shadow"].attrs["names"])[:2] == ["valid", "shadow"]
    found = 0
    for part in ("train", "validation", "test"):
        document = json.loads((out / f"annotations_{part}.json").read_text())
        kinds = {one["id"]: one["name"] for one in document["categories"]}
        for one in document["annotations"]:
            row = one["image_id"]
            assert one["name"].startswith("building_") and kinds[one["category_id"]] == "building"
            code, kind = table[rows[row], one["name"]]
            assert kind == "building" and one["area"] == (masks[row] == code).sum() > 0
            found += 1
    # those in the 80 m that the chips show, each an instance of its own
    assert 2 * np.count_nonzero(files == "buildings16") < found
    assert table[0, "ground"][1] == "soil" if files[0] == "buildings16" else (0, "ground") not in table


def test_a_changed_scene_file_is_another_data_set(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Samples of two states of a scene must not stand in one file as of one recipe."""
    for name in ("one", "two"):
        scene = (scenes_dir() / "dihedral.xml").read_text(encoding="utf-8")
        (tmp_path / f"{name}.xml").write_text(scene, encoding="utf-8")
    recipe, out = tmp_path / "own.toml", tmp_path / "out"
    recipe.write_text(
        "[dataset]\nsamples = 2\n[images]\npixels_azimuth = 16\npixels_range = 16\n[scene]\n"
        "file = { choice = ['one.xml', 'two.xml'] }\n[tracing]\nmethod = 'raster'\n"
    )
    first = made(recipe, out, "--jobs", "1")
    assert made(recipe, out, "--jobs", "1") == first
    changed = (
        (tmp_path / "two.xml").read_text(encoding="utf-8").replace("<scene", "<!-- as it was --><scene", 1)
    )
    (tmp_path / "two.xml").write_text(changed, encoding="utf-8")
    assert made(recipe, out, "--jobs", "1") == first  # nothing that the radar sees
    point = (scenes_dir() / "trihedral.xml").read_text(encoding="utf-8")
    shutil.copytree(scenes_dir() / "meshes", tmp_path / "meshes", ignore=shutil.ignore_patterns("targets"))
    (tmp_path / "two.xml").write_text(point, encoding="utf-8")
    assert cli.main(["dataset", str(recipe), "-o", str(out), "--quiet"]) == 2
    assert "--force" in capsys.readouterr().err
