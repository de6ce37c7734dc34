"""File of finished blocks of pulses, from which an interrupted run continues.

Blocks are traced independently, so that a run that continues from the file has the same bits as one that was not
interrupted.
"""

import dataclasses
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from sarmitsuba.core.arrays import C64
from sarmitsuba.effects.plan import EffectsPlan
from sarmitsuba.machine.backend import mi
from sarmitsuba.machine.journal import Journal, Label, fits, is_echo
from sarmitsuba.simulation.execution.statistics import STATISTICS_FORM, TraceStatistics

_LONGEST_BLOCK = 1 << 30  # pulses
_FORMS = {
    "run": {"kind": str, "mark": str, "effects": str, "variant": str, "part": str},
    "interval": {"kind": str, "pulses": int, "settled": bool, "growth": {str: float}, "grid_bytes": int},
    "block": {
        **{"kind": str, "subset": int, "start": int, "stop": int, "grid_bytes": int},
        "statistics": STATISTICS_FORM,
    },
}


class FinishedBlocks:
    """The finished blocks of one run, in a file (:class:`sarmitsuba.machine.journal.Journal`).

    Parameters
    ----------
    path : file; contents of another scene, other settings or another program version are discarded
    run_hash : hash of scene, settings and program (:func:`sarmitsuba.simulation.execution.fingerprint.fingerprint`)
    plan : decided effects
    part : text that identifies the pass of rays to which the blocks belong
    shape : layers of one ray subset, pulses and samples of the run's data

    Attributes
    ----------
    path : of the file
    found : number of blocks of an earlier run, over all ray subsets
    stale : whether the file held blocks of another run hash
    interval : pulses per block; None where not yet determined
    settled : whether the interval is final
    growth : exponent with which each channel's change grows with time, measured for that interval
    grid_bytes : of the largest accumulator grid of the stored blocks

    Raises
    ------
    OutputError
        The file cannot be written, or is not a file of finished blocks.
    """

    def __init__(
        self, path: Path | str, run_hash: str, plan: EffectsPlan, part: str, shape: tuple[int, int, int]
    ) -> None:
        self._shape = shape
        self._journal = Journal(path, self._is_record)
        self.path = self._journal.path
        self.interval: int | None = None
        self.settled = False
        self.growth: dict[str, float] = {}
        self._first = {
            "kind": "run",
            "mark": run_hash,
            "effects": repr(
                (plan.flags, plan.max_depth)
            ),  # a plan given by the caller is not part of the run hash
            "variant": mi.variant(),
            "part": part,
        }
        labels = self._journal.labels
        self.stale = bool(labels) and {**labels[0], "part": part} != self._first
        if not labels or labels[0] != self._first:
            self._begin()
        self._rows = {
            self._key(label): i for i, label in enumerate(self._journal.labels) if label["kind"] == "block"
        }
        for label in self._journal.labels:
            if label["kind"] == "interval":
                self.interval, self.settled = int(label["pulses"]), bool(label["settled"])
                self.growth = {str(c): float(x) for c, x in label["growth"].items()}
        self.found = len(self._rows)
        self.grid_bytes = max((label.get("grid_bytes", 0) for label in self._journal.labels), default=0)

    def _is_record(self, label: Label, payload: bytes) -> bool:
        """Whether a record is one that such a run writes."""
        kind = label.get("kind")
        if not isinstance(kind, str) or not fits(label, _FORMS.get(kind, None)):
            return False
        if kind != "block":
            return not payload and 1 <= label.get("pulses", 1) <= _LONGEST_BLOCK
        layers, pulses, samples = self._shape
        start, stop = label["start"], label["stop"]
        return start < stop <= pulses and is_echo(payload, layers * (stop - start) * samples)

    def begin_again(self, part: str) -> None:
        """Discard all blocks and hold those of other rays, identified by ``part``."""
        self._first["part"] = part
        self.interval, self.settled, self.growth, self.found = None, False, {}, 0
        self._begin()

    def _begin(self) -> None:
        self._journal.clear()
        self._journal.append(self._first, np.empty(0, np.uint8))
        self._rows = {}

    @staticmethod
    def _key(label: Label) -> tuple[int, int, int]:
        return label["subset"], label["start"], label["stop"]

    def note(self, interval: int, *, settled: bool, growth: Mapping[str, float]) -> None:
        """Store the number of pulses per block and ``growth``; blocks of another number are discarded."""
        if not settled:
            self._begin()
        self.interval, self.settled, self.growth = interval, settled, dict(growth)
        label = {"kind": "interval", "pulses": interval, "settled": settled, "growth": self.growth}
        self._journal.append(label | {"grid_bytes": self.grid_bytes}, np.empty(0, np.uint8))

    def take(self, subset: int, start: int, stop: int) -> tuple[C64, TraceStatistics] | None:
        """Profiles (flat complex64) and statistics of the stored block of pulses ``start:stop``; None if not stored."""
        row = self._rows.get((subset, start, stop))
        if row is None:
            return None
        statistics = TraceStatistics(**self._journal.labels[row]["statistics"])
        return self._journal.payload(row, np.complex64), statistics

    def put(
        self,
        subset: int,
        start: int,
        stop: int,
        profiles: C64,
        statistics: TraceStatistics,
        grid_bytes: int,
    ) -> None:
        """Store a block.

        Parameters
        ----------
        subset : index of the ray subset
        start, stop : its pulses
        profiles : (n_layers, n_pulses, n_samples), with one more pulse where another block follows
        statistics : of its tracing
        grid_bytes : of the largest accumulator grid so far

        Raises
        ------
        OutputError
            The file cannot be written; blocks stored before are kept.
        """
        self.grid_bytes = max(self.grid_bytes, grid_bytes)
        label = {
            "kind": "block",
            "subset": subset,
            "start": start,
            "stop": stop,
            "statistics": dataclasses.asdict(statistics),
            "grid_bytes": grid_bytes,
        }
        self._rows[self._key(label)] = len(self._journal.labels)
        self._journal.append(label, profiles)

    def close(self) -> None:
        """Close the file and keep it for a later run."""
        self._journal.close()

    def remove(self) -> None:
        """Close and delete the file."""
        self._journal.remove()

    def __str__(self) -> str:
        """One line about blocks of an earlier run; empty where there are none."""
        if self.stale:
            return (
                f"{self.path}: finished blocks of another scene, of other settings or of another version of the "
                "program; begun anew"
            )
        if self.found:
            return (
                f"{self.path}: {self.found} finished blocks of an interrupted run of this scene, used again"
            )
        return ""
