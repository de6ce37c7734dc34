"""What a killed writer had appended is read again, to the last whole record."""

from pathlib import Path

import numpy as np
import pytest

from sarmitsuba.errors import OutputError
from sarmitsuba.io.journal import MAGIC, Journal
from sarmitsuba.io.locking import sole_writer


def arrays() -> list[np.ndarray]:
    rng = np.random.default_rng(11)
    return [(rng.normal(size=n) + 1j * rng.normal(size=n)).astype(np.complex64) for n in (3, 1, 0, 40, 7)]


def written(path: Path) -> list[int]:
    """A journal of all arrays; the sizes of the file after each."""
    journal, sizes = Journal(path), [len(MAGIC)]
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
        journal = Journal(path)
        count = sum(size <= cut for size in sizes[1:])
        assert [label["n"] for label in journal.labels] == list(range(count))
        for i in range(count):
            np.testing.assert_array_equal(journal.payload(i, np.complex64), arrays()[i])
        # what is appended next follows the last whole record
        journal.append({"n": "next"}, arrays()[3])
        journal.close()
        again = Journal(path)
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
        journal = Journal(path)
        # the size of a record that claims more bytes than there are is no reason to read them
        assert len(journal.labels) == sum(size <= place for size in sizes[1:])
        journal.close()


def test_a_file_of_another_kind_is_left_alone(tmp_path: Path) -> None:
    path = tmp_path / "mine"
    path.write_text("mine")
    with pytest.raises(OutputError, match="was not written by the program"):
        Journal(path)
    assert path.read_text() == "mine"
    with pytest.raises(OutputError, match="cannot write: "):
        Journal(tmp_path / "no such folder" / "j")


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
