"""What a killed writer had appended is read again, to the last whole record."""

from pathlib import Path

import numpy as np
import pytest

from sarmitsuba.core.errors import OutputError
from sarmitsuba.machine.atomic import describe_end, withdraw_resuming
from sarmitsuba.machine.journal import MAGIC, Journal, fits, is_echo, remove_journal
from sarmitsuba.machine.output import sole_writer


def anything(label: object, payload: bytes) -> bool:
    """Accept every record."""
    return True


def arrays() -> list[np.ndarray]:
    rng = np.random.default_rng(11)
    return [(rng.normal(size=n) + 1j * rng.normal(size=n)).astype(np.complex64) for n in (3, 1, 0, 40, 7)]


def written(path: Path) -> list[int]:
    """A journal of all arrays; the sizes of the file after each."""
    journal, sizes = Journal(path, anything), [len(MAGIC)]
    for i, array in enumerate(arrays()):
        journal.append({"n": i}, array)
        sizes.append(path.stat().st_size)
    journal.close()
    return sizes


def test_whatever_the_length_at_which_it_was_cut_whole_records_come_back(tmp_path: Path) -> None:
    path = tmp_path / "j"
    sizes = written(path)
    whole = path.read_bytes()
    assert len(whole) == sizes[-1]
    near = {size + step for size in sizes for step in (-1, 0, 1)}
    for cut in sorted(near & set(range(len(whole) + 1)) | set(range(0, len(whole), 13))):
        path.write_bytes(whole[:cut])
        journal = Journal(path, anything)
        count = sum(size <= cut for size in sizes[1:])
        assert [label["n"] for label in journal.labels] == list(range(count))
        for i in range(count):
            np.testing.assert_array_equal(journal.payload(i, np.complex64), arrays()[i])
        # what is appended next follows the last whole record
        journal.append({"n": "next"}, arrays()[3])
        journal.close()
        again = Journal(path, anything)
        assert len(again.labels) == count + 1
        np.testing.assert_array_equal(again.payload(count, np.complex64), arrays()[3])
        again.close()


@pytest.mark.parametrize("seed", range(4))
def test_a_damaged_byte_ends_the_journal_before_its_record(tmp_path: Path, seed: int) -> None:
    rng = np.random.default_rng(seed)
    path = tmp_path / "j"
    sizes = written(path)
    whole = path.read_bytes()
    for place in rng.integers(len(MAGIC), len(whole), 40):
        damaged = bytearray(whole)
        damaged[place] ^= 1 << rng.integers(8)
        path.write_bytes(damaged)
        journal = Journal(path, anything)
        # the size of a record that claims more bytes than there are is no reason to read them
        assert len(journal.labels) == sum(size <= place for size in sizes[1:])
        journal.close()


def test_a_file_of_another_kind_is_left_alone(tmp_path: Path) -> None:
    path = tmp_path / "mine"
    path.write_text("mine")
    with pytest.raises(OutputError, match="was not written by the program"):
        Journal(path, anything)
    assert path.read_text() == "mine"
    with pytest.raises(OutputError, match="cannot write: "):
        Journal(tmp_path / "no such folder" / "j", anything)


def test_a_folder_has_one_writer_and_no_litter_of_the_dead(tmp_path: Path) -> None:
    pytest.importorskip("fcntl")
    nobody = 2**22 + 1  # above Linux's highest
    alive, dead = (tmp_path / f".sarmitsuba-part-{process}-0.h5" for process in (1, nobody))
    others = [tmp_path / name for name in (f".raw.{nobody}.part.h5", f".notes.{nobody}.part.txt", "raw.part")]
    for path in (alive, dead, *others):
        path.touch()
    folder = tmp_path / f".sarmitsuba-part-{nobody}-1"
    folder.mkdir()
    with sole_writer(tmp_path):
        assert alive.exists() and all(path.exists() for path in (*others, folder)) and not dead.exists()
        with (
            pytest.raises(OutputError, match="another run is writing into this folder"),
            sole_writer(tmp_path),
        ):
            pass
    with sole_writer(tmp_path):
        pass


def test_a_record_that_is_not_accepted_ends_the_journal(tmp_path: Path) -> None:
    path = tmp_path / "j"
    written(path)
    journal = Journal(path, lambda label, payload: label["n"] != 2)
    assert [label["n"] for label in journal.labels] == [0, 1]
    journal.close()
    again = Journal(path, anything)
    assert len(again.labels) == 2  # what followed is gone
    again.close()


@pytest.mark.parametrize(
    ("value", "form", "fit"),
    [
        (3, int, True),
        (-1, int, False),
        (True, int, False),
        (3.0, int, False),
        (10**400, int, False),
        (10**400, float, False),
        (2, float, True),
        (float("nan"), float, False),
        (float("inf"), float, False),
        ("x", str, True),
        ("x" * 200_000, str, False),
        (None, (float, None), True),
        ("x", (float, None), False),
        ([1, 2], [int], True),
        ([1, "x"], [int], False),
        ([1, "x"], [int, str], True),
        ([1], [int, str], False),
        ({"a": 1}, {"a": int}, True),
        ({"a": 1, "b": 2}, {"a": int}, False),
        ({}, {"a": int}, False),
        ({"b": 1}, {str: int}, True),
        ({"b": None}, {str: int}, False),
        ([], {str: int}, False),
        ([None, {}], object, True),
        (5, object, True),
        (5, None, False),
        (1, bool, False),
        (False, bool, True),
    ],
)
def test_values_of_labels_have_a_form(value: object, form: object, fit: bool) -> None:
    assert fits(value, form) == fit


def test_payloads_are_echoes_within_bounds() -> None:
    good = np.array([1 + 2j, -1e14], np.complex64)
    assert is_echo(good.tobytes()) and is_echo(good.tobytes(), 2)
    assert not is_echo(good.tobytes(), 3) and not is_echo(good.tobytes()[:-1])
    for bad in (np.nan, np.inf, 1e30):
        assert not is_echo(np.array([1.0, bad], np.complex64).tobytes())


def test_what_a_stopped_run_resumes_from_is_said(tmp_path: Path) -> None:
    """Only where a part is finished, and no longer once it is dropped."""
    withdraw_resuming()
    clean = "no half-written file was left behind"
    assert describe_end() == clean
    path, study = tmp_path / "j", tmp_path / "study"
    journal = Journal(path, anything)
    journal.append({"kind": "run"}, np.empty(0, np.uint8))
    assert describe_end() == clean
    journal.append({"kind": "block"}, np.ones(3, np.complex64))
    assert describe_end() == f"{clean}; the same command resumes"
    other = Journal(study, anything, "the same command with --resume resumes")
    other.append({}, np.ones(3, np.complex64))
    other.remove()
    assert describe_end() == f"{clean}; the same command resumes"
    journal.close()
    remove_journal(path)
    assert describe_end() == clean
    again = Journal(path, anything)
    again.append({}, np.ones(3, np.complex64))
    again.close()
    found = Journal(path, anything)  # of an earlier run
    assert describe_end().endswith("; the same command resumes")
    found.clear()
    assert describe_end() == clean
    found.close()
