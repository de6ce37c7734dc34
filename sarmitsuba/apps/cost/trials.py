"""Trials of a cost study: each is run once, and kept in a file from which an interrupted study continues."""

import json
import math
import warnings
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from sarmitsuba.apps.cost.clock import StudyClock
from sarmitsuba.apps.cost.trial import Prepared, Trial, TrialSetting, run_trial
from sarmitsuba.core.errors import SarmitsubaWarning
from sarmitsuba.machine.journal import Journal, Label, fits, is_echo
from sarmitsuba.scene.scene import Scene
from sarmitsuba.signal.focusing import default_grid
from sarmitsuba.signal.image.sar_image import ImageGrid
from sarmitsuba.simulation.execution.statistics import STATISTICS_FORM, TraceStatistics

_FIRST = "cost study"
_FORMS = {
    _FIRST: {"kind": str, "hash": str},
    "trial": {
        **{"kind": str, "key": str, "shape": [int, int], "stages": {str: float}, "compile_seconds": float},
        **{"peak_bytes": int, "statistics": STATISTICS_FORM, "interval": int},
    },
}
# two runs agree whose seconds differ by less than this factor; a third decides between others
AGREE = 1.1


class Trials:
    """Trials of one study.

    Parameters
    ----------
    clock : time source
    state : file that keeps every finished trial; None: none
    run_hash : of scene, settings and program; trials of another study are dropped
    done : called after every trial

    Attributes
    ----------
    reused : number of trials taken from the file
    compile_seconds : of the trials that were run here
    stale : whether the file had trials of another study, now dropped
    """

    def __init__(
        self,
        clock: StudyClock,
        state: Path | None = None,
        run_hash: str = "",
        done: Callable[[], None] = lambda: None,
    ) -> None:
        self.clock, self.done, self.reused, self.stale = clock, done, 0, False
        self.compile_seconds = 0.0
        self._made: dict[str, Trial] = {}
        self._prepared: dict[str, Prepared] = {}
        self._last: tuple[str, Trial] | None = None
        self._journal = Journal(state, _is_record) if state is not None else None
        if self._journal is None:
            return
        first = {"kind": _FIRST, "hash": run_hash}
        if self._journal.labels[:1] != [first]:
            self.stale = bool(self._journal.labels)
            self._journal.clear()
            self._journal.append(first, np.empty(0, np.uint8))

    def run(
        self,
        scene: Scene,
        setting: TrialSetting,
        grid: ImageGrid | None = None,
        *,
        pass_index: int = 0,
        again: int = 0,
        refocus: bool = False,
    ) -> Trial:
        """The trial of a setting on a part of the scene, run once.

        Parameters
        ----------
        again : number of a repetition
        refocus : whether a repetition focuses the same echoes again, where they are still held
        """
        part = _part(scene)
        key = _key(part, setting, pass_index, again)
        if key not in self._made:
            kept = self._kept(key, setting, scene, grid)
            echoes = 0 if refocus else again
            self._made[key] = kept or self._run(key, part, scene, setting, grid, pass_index, echoes)
            self.done()
        return self._made[key]

    def steady(
        self,
        scene: Scene,
        setting: TrialSetting,
        grid: ImageGrid | None = None,
        *,
        pass_index: int = 0,
        refocus: bool = False,
    ) -> Trial:
        """The trial by its seconds of two runs, the faster one, or of three if two differ: the one in the middle.

        A run is slower where another program disturbs it. One that compiled kernels may be faster, where more was
        subtracted for compiling than it took.
        """

        def made(again: int) -> Trial:
            return self.run(scene, setting, grid, pass_index=pass_index, again=again, refocus=refocus)

        runs = sorted((made(again) for again in range(2)), key=lambda trial: trial.seconds)
        if runs[1].seconds <= AGREE * runs[0].seconds:
            return runs[0]
        return sorted((*runs, made(2)), key=lambda trial: trial.seconds)[1]

    @property
    def count(self) -> int:
        """Number of trials so far."""
        return len(self._made)

    def close(self) -> None:
        """Close the file; its trials are kept."""
        if self._journal is not None:
            self._journal.close()

    def _run(
        self,
        key: str,
        part: str,
        scene: Scene,
        setting: TrialSetting,
        grid: ImageGrid | None,
        pass_index: int,
        again: int,
    ) -> Trial:
        if part not in self._prepared:
            self._prepared[part] = Prepared.of(scene, self.clock.source)
        traced = _key(part, setting.traced, pass_index, again)
        same = self._last[1] if self._last is not None and self._last[0] == traced else None
        with warnings.catch_warnings():
            if self._made:  # the first has the scene's own settings; those that a study tries concern nobody
                warnings.simplefilter("ignore", SarmitsubaWarning)
            trial = run_trial(
                scene,
                setting,
                grid,
                pass_index=pass_index,
                clock=self.clock,
                prepared=self._prepared[part],
                echoes_of=same,
            )
        self._last = (traced, trial)
        self.compile_seconds += trial.compile_seconds
        trial = replace(trial, raw=None)  # echoes of the latest trial alone are held
        if self._journal is not None:
            label = {
                "kind": "trial",
                "key": key,
                "shape": list(trial.image.shape),
                "stages": dict(trial.stages),
                "compile_seconds": trial.compile_seconds,
                "peak_bytes": trial.peak_bytes,
                "statistics": vars(trial.statistics),
                "interval": trial.key_pulse_interval,
            }
            self._journal.append(label, trial.image.astype(np.complex64))
        return trial

    def __str__(self) -> str:
        """One line about dropped trials of another study; empty where there are none."""
        if not self.stale or self._journal is None:
            return ""
        return (
            f"{self._journal.path}: trials of another scene, of other settings or of another version of the program; "
            "begun anew"
        )

    def _kept(self, key: str, setting: TrialSetting, scene: Scene, grid: ImageGrid | None) -> Trial | None:
        """The trial from the file."""
        if self._journal is None:
            return None
        row = next((i for i, x in enumerate(self._journal.labels) if x.get("key") == key), None)
        if row is None:
            return None
        shape = (grid or default_grid(scene.radar, scene.image)).shape
        label, image = self._journal.labels[row], self._journal.payload(row, np.complex64)
        if tuple(label["shape"]) != shape:
            return None
        self.reused += 1
        return Trial(
            setting,
            image.reshape(shape),
            dict(label["stages"]),
            label["compile_seconds"],
            label["peak_bytes"],
            TraceStatistics(**label["statistics"]),
            label["interval"],
        )


def _is_record(label: Label, payload: bytes) -> bool:
    """Whether a record is one that a study writes."""
    kind = label.get("kind")
    if not isinstance(kind, str) or not fits(label, _FORMS.get(kind, None)):
        return False
    if kind == _FIRST:
        return not payload
    times = (*label["stages"].values(), label["compile_seconds"], *label["statistics"].values())
    return bool(label["stages"]) and min(times) >= 0.0 and is_echo(payload, math.prod(label["shape"]))


def _part(scene: Scene) -> str:
    """Which part of the scene it is."""
    image, track = scene.image, scene.radar.track
    return f"{image.extent_azimuth:.9g} {image.extent_range:.9g} {track.n_pulses}"


def _key(part: str, setting: TrialSetting, pass_index: int, again: int) -> str:
    return json.dumps([part, dict(sorted(setting.changes.items())), pass_index, again])
