"""Blocks of pulses that are traced already, on the disk: a run that was killed goes on from them.

Tracing a block takes nothing from the blocks before it, so that a run that takes some of its blocks from here has the
same bits as one that traced them all.
"""

import dataclasses
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sarmitsuba.backend import mi
from sarmitsuba.effects.plan import EffectsPlan
from sarmitsuba.io.journal import Journal, Label
from sarmitsuba.simulation.statistics import TraceStatistics

C64 = NDArray[np.complex64]


class FinishedBlocks:
    """The finished blocks of one run, in a file (:class:`sarmitsuba.io.journal.Journal`).

    Parameters
    ----------
    path : file; what another scene, other settings or another program left there is dropped
    run_hash : of scene, settings and program (:func:`sarmitsuba.simulation.fingerprint.fingerprint`)
    plan : decided effects
    part : of the work on the scene that the blocks are of: which pass of rays

    Attributes
    ----------
    path : of the file
    found : blocks that an earlier run left, all ray subsets counted
    stale : whether what an earlier run left belonged to something else
    interval : pulses per block that the run has come to; None where it has not said so yet
    settled : whether that is final
    grid_bytes : of the largest accumulator grid of the blocks that are kept

    Raises
    ------
    OutputError
        The file cannot be written, or is not one of these.
    """

    def __init__(self, path: Path | str, run_hash: str, plan: EffectsPlan, part: str = "") -> None:
        self._journal = Journal(path)
        self.path = self._journal.path
        self.interval: int | None = None
        self.settled = False
        self._first = {
            "kind": "run",
            "mark": run_hash,
            "effects": repr((plan.flags, plan.max_depth)),  # a plan of the caller's own is not in the hash
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
        self.found = len(self._rows)
        self.grid_bytes = max((label.get("grid_bytes", 0) for label in self._journal.labels), default=0)

    def _begin(self) -> None:
        self._journal.clear()
        self._journal.append(self._first, np.empty(0, np.uint8))
        self._rows = {}

    @staticmethod
    def _key(label: Label) -> tuple[int, int, int]:
        return label["subset"], label["start"], label["stop"]

    def note(self, interval: int, *, settled: bool) -> None:
        """Keep the pulses per block; where they are not settled, blocks are cut anew and those so far dropped."""
        if not settled:
            self._begin()
        self.interval, self.settled = interval, settled
        self._journal.append(
            {"kind": "interval", "pulses": interval, "settled": settled, "grid_bytes": self.grid_bytes},
            np.empty(0, np.uint8),
        )

    def take(self, subset: int, start: int, stop: int) -> tuple[C64, TraceStatistics] | None:
        """Profiles, flat complex64, and figures of the block of pulses ``start:stop``; None where there is none."""
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
        """Keep a block.

        Parameters
        ----------
        subset : index of the ray subset
        start, stop : its pulses
        profiles : (n_layers, n_pulses, n_samples), of one pulse more than that where another block follows
        statistics : of its tracing
        grid_bytes : of the largest accumulator grid so far

        Raises
        ------
        OutputError
            The disk refused; what is finished stays.
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
        """Close the file and leave it for the run that goes on from it."""
        self._journal.close()

    def remove(self) -> None:
        """Close and delete the file."""
        self._journal.remove()

    def __str__(self) -> str:
        """One line about what an earlier run left; empty where it left nothing."""
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


__all__ = ["FinishedBlocks"]
