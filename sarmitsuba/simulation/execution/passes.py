"""Passes of rays until the image reaches a target error; all passes are averaged, interrupted runs continue.

The running mean is stored in a file between runs.
"""

import dataclasses
import json
import math
import os
import struct
import time
import tokenize
import zipfile
import zlib
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TypeVar

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

from sarmitsuba.core.arrays import C64, check_pulses
from sarmitsuba.core.constants import DEFAULT_WINDOW, RAY_ERROR_ORDER
from sarmitsuba.core.errors import DataError
from sarmitsuba.core.progress import Progress, silent
from sarmitsuba.core.timing import Clock
from sarmitsuba.core.units import power_from_db
from sarmitsuba.core.witness import Witness
from sarmitsuba.effects.effect import EFFECTS, idealise_receiver
from sarmitsuba.machine.atomic import atomic_path, offer_resuming
from sarmitsuba.machine.encoding import json_value, to_json
from sarmitsuba.machine.exclusive import exclusive
from sarmitsuba.machine.regular_files import open_regular
from sarmitsuba.radar.radar import Radar
from sarmitsuba.scene.scene import Scene, SceneLike
from sarmitsuba.scene.settings import Switch
from sarmitsuba.signal.focusing import default_grid, focus
from sarmitsuba.signal.image import ImageGrid, SarImage
from sarmitsuba.signal.raw_data import Layer, RawData, channels_of, sum_layers
from sarmitsuba.signal.receive import receive
from sarmitsuba.simulation.execution.error_bars import (
    PASSES,
    SUBSETS,
    ErrorBars,
    Source,
    add_error_bars,
    estimate_error,
    estimate_pass_error,
    exchange_two_sets,
)
from sarmitsuba.simulation.execution.fingerprint import fingerprint
from sarmitsuba.simulation.execution.finished import FinishedBlocks
from sarmitsuba.simulation.execution.raw import echoes
from sarmitsuba.simulation.execution.run import Ready, Run
from sarmitsuba.simulation.execution.tracing import Workers

G = TypeVar("G", bound=np.generic)
# exceptions of NumPy, zip and JSON for a damaged file
_DAMAGE = (
    ArithmeticError,
    DataError,
    EOFError,
    LookupError,
    MemoryError,
    OSError,
    RuntimeError,
    SyntaxError,
    TypeError,
    ValueError,
    struct.error,
    tokenize.TokenError,  # of NumPy, for a header
    zipfile.BadZipFile,
    zlib.error,
)
# of the file, and bytes of its record at most
_ARRAYS, _RECORD = ("data", "change", "record"), 1 << 24
# bound on the amplitude of an echo relative to the transmitted pulse: that of a passive scene, ten times for spikes
_MOST_RETURNED = 10.0


@dataclass(frozen=True)
class PassLayout:
    """Required contents of the state file of a run.

    Parameters
    ----------
    layers : of its raw data
    n_pulses, n_samples : of a layer
    most : largest amplitude that an echo can have, sqrt(W)
    """

    layers: tuple[Layer, ...]
    n_pulses: int
    n_samples: int
    most: float

    @staticmethod
    def of(scene: Scene, layers: tuple[Layer, ...]) -> "PassLayout":
        """Layout for the raw data of a scene."""
        radar = scene.radar
        nearest = max(float(np.min(radar.window.start_range)), 1.0)
        points = sum(math.sqrt(point.rcs) for point in scene.points) * radar.amplitude_constant / nearest**2
        most = _MOST_RETURNED * (math.sqrt(radar.transmit_power) + points)
        return PassLayout(layers, radar.track.n_pulses, radar.window.n_samples, most)

    def shape(self, n_layers: int) -> tuple[int, int, int]:
        """Shape of an array of ``n_layers`` layers."""
        return n_layers, self.n_pulses, self.n_samples

    @property
    def n_bytes(self) -> int:
        """Bytes of the largest state file."""
        layers = len(self.layers) + len(channels_of(self.layers))
        return 8 * math.prod(self.shape(layers)) + 2 * _RECORD


@dataclass
class Passes:
    """Running mean of the passes so far.

    Parameters
    ----------
    fingerprint : run hash of the scene and settings
    count : passes done
    seconds : spent on them, over all runs
    data : (n_layers, n_pulses, n_samples) complex64, mean over the passes weighted by their rays, subsets separately
    layers : labels
    history : after every pass: seconds so far, error (dB)
    metadata : of the last pass's raw data
    levels : of every pass, number of doublings of its rays
    weight : total of all passes
    rays : of one key pulse of the last pass
    ratio_db : error of the image minus that of the raw data, dB, as last measured; None if not measured
    source : of the error estimate from which ``ratio_db`` was measured
    change : (n_channels, n_pulses, n_samples) complex64, the last pass minus the mean of those before it; None for one
    share : weight of the last pass in the mean
    """

    fingerprint: str
    count: int = 0
    seconds: float = 0.0
    data: C64 | None = None
    layers: tuple[Layer, ...] = ()
    history: list[tuple[float, float]] = field(default_factory=list)
    metadata: dict[str, object] = field(default_factory=dict)
    levels: list[int] = field(default_factory=list)
    weight: float = 0.0
    rays: int = 0
    change: C64 | None = None
    share: float = 1.0
    ratio_db: float | None = None
    source: Source = SUBSETS

    def add(self, raw: RawData, level: int) -> None:
        """Add one more pass to the mean, weighted by its rays."""
        own = 2.0**level
        self.weight += own
        self.share = own / self.weight
        self.count += 1
        self.levels.append(level)
        self.layers, self.metadata = raw.layers, dict(raw.metadata)
        self.rays = raw.metadata["sampling"].get("rays_per_key_pulse", 0)
        if self.data is None:
            self.data = raw.data.copy()
        else:
            step = raw.data - self.data
            self.change = sum_layers(step, self.layers)
            step *= np.float32(self.share)
            self.data += step

    def save(self, path: Path) -> None:
        """Write the state file atomically."""
        record = {
            "fingerprint": self.fingerprint,
            "count": self.count,
            "seconds": self.seconds,
            "history": self.history,
            "levels": self.levels,
            "weight": self.weight,
            "share": self.share,
            "rays": self.rays,
            "ratio_db": self.ratio_db,
            "source": self.source,
            "layers": [dataclasses.astuple(layer) for layer in self.layers],
            "metadata": to_json(self.metadata),
        }
        none = np.empty((0, 0, 0), np.complex64)
        with atomic_path(path) as temporary, open(temporary, "wb") as file:
            np.savez(
                file,
                data=np.asarray(self.data),
                change=none if self.change is None else self.change,
                record=np.frombuffer(json.dumps(record).encode(), dtype=np.uint8),
            )
        offer_resuming(path)

    @staticmethod
    def load(path: Path, fingerprint: str, layout: PassLayout) -> "Passes":
        """Passes of an earlier run from the state file; empty where there is none.

        Parameters
        ----------
        path : of the file
        fingerprint : run hash of the present scene and settings
        layout : of the run's raw data

        Raises
        ------
        DataError
            The file belongs to another scene or other settings, cannot be read, or is inconsistent.
        """
        if not os.path.exists(path):
            return Passes(fingerprint)
        try:
            # opened here: NumPy does not close a damaged file that it opened itself
            with (
                os.fdopen(open_regular(path, layout.n_bytes), "rb") as opened,
                zipfile.ZipFile(opened) as file,
            ):
                found = sorted((info.filename, info.compress_type) for info in file.infolist())
                if found != sorted((f"{name}.npy", zipfile.ZIP_STORED) for name in _ARRAYS):
                    raise DataError(f"it does not hold {', '.join(_ARRAYS)}, uncompressed")
                passes = _read_record(
                    _array(file, "record", np.uint8, (None,)).tobytes(), fingerprint, layout
                )
                passes.data = data = _array(file, "data", np.complex64, layout.shape(len(layout.layers)))
                channels = len(channels_of(layout.layers)) if passes.count > 1 else 0
                shape = layout.shape(channels) if channels else (0, 0, 0)
                change = _array(file, "change", np.complex64, shape)
                passes.change = change if channels else None
            _check_values(data, layout.most)
            if passes.change is not None:
                _check_values(passes.change, 2.0 * layout.most)
        except _DAMAGE as error:
            reason = " ".join(str(error).split())
            raise DataError(
                f"{path}: cannot read the passes of an earlier run: {reason}; remove the file or choose another output"
            ) from error
        return passes


def _array(file: zipfile.ZipFile, name: str, kind: type[G], shape: tuple[int | None, ...]) -> NDArray[G]:
    """Array of a given type and shape (None: any length up to that of a record); the header is checked first."""
    with file.open(f"{name}.npy") as member:
        version = npy.read_magic(member)
        read = {(1, 0): npy.read_array_header_1_0, (2, 0): npy.read_array_header_2_0}[version]
        found, _, dtype = read(member)
    wanted = tuple(_RECORD if size is None else size for size in shape)
    same = len(found) == len(wanted) and all(
        (0 <= a <= b) if size is None else a == b for a, b, size in zip(found, wanted, shape, strict=True)
    )
    if dtype != kind or not same:
        raise DataError(f"{name} is {dtype} of shape {found}, not {np.dtype(kind)} of shape {wanted}")
    with file.open(f"{name}.npy") as member:
        return np.asarray(npy.read_array(member, allow_pickle=False))


def _read_record(text: bytes, fingerprint: str, layout: PassLayout) -> Passes:
    """Passes without their data, from the file's record; an inconsistent record is refused."""
    record = json_value(text)
    if str(record["fingerprint"]) != fingerprint:
        raise DataError("they are of another scene or of other settings")
    count, levels, history = record["count"], record["levels"], record["history"]
    rays, seconds, metadata = record["rays"], record["seconds"], record["metadata"]
    if not (_whole(count, 1, 10**6) and isinstance(levels, list) and isinstance(history, list)):
        raise DataError("count, levels or history is not valid")
    if len(levels) != count or len(history) != count or not all(_whole(level, 0, 60) for level in levels):
        raise DataError(f"{count} passes of {len(levels)} levels and {len(history)} errors")
    times = [float(row[0]) for row in history if len(row) == 2]
    if not (_whole(rays, 0, 2**62) and len(times) == count and isinstance(metadata, dict)):
        raise DataError("rays, history or metadata is not valid")
    if times != sorted(times) or not all(map(math.isfinite, times)) or times[0] < 0.0:
        raise DataError("the seconds of its history do not follow each other")
    weight, share = float(record["weight"]), float(record["share"])
    whole = sum(2.0**level for level in levels)
    if weight != whole or share != 2.0 ** levels[-1] / whole:
        raise DataError(f"weight {weight:g} and share {share:g} do not agree with its levels")
    layers = [dataclasses.astuple(layer) for layer in layout.layers]
    if [tuple(row) for row in record["layers"]] != layers:
        raise DataError("its layers are not those of this run")
    if record["source"] not in (PASSES, SUBSETS) or not 0.0 <= float(seconds) < math.inf:
        raise DataError("source or seconds is not valid")
    ratio = None if record["ratio_db"] is None else float(record["ratio_db"])
    return Passes(
        fingerprint=str(record["fingerprint"]),
        count=int(count),
        seconds=float(seconds),
        layers=layout.layers,
        history=[(float(a), float(b)) for a, b in history],
        metadata=metadata,
        levels=list(levels),
        weight=weight,
        rays=int(rays),
        share=share,
        ratio_db=ratio if ratio is not None and math.isfinite(ratio) else None,  # else measured again
        source=PASSES if record["source"] == PASSES else SUBSETS,
    )


def _whole(value: object, least: int, most: int) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and least <= value <= most


def _check_values(data: C64, most: float) -> None:
    """Raise a DataError where echoes are not finite, or stronger than physically possible."""
    check_pulses(data)
    largest = max(float(np.abs(plane).max(initial=0.0)) for plane in data)
    if largest > most:
        raise DataError(
            f"an echo of {largest:.3g} sqrt(W), over the {most:.3g} sqrt(W) that the radar could receive"
        )


STATE_FILE = "passes.npz"
# most rays of one lattice; denser passes are repeated instead
MAX_RAYS = 16_000_000


@dataclass(frozen=True, eq=False)
class Refinement:
    """Result of :func:`refine`.

    Parameters
    ----------
    raw : mean over all passes, subsets kept separately
    image : focused from it, with ``sampling_error`` in its metadata
    passes : number, over all runs
    error_db : estimated sampling error of the image (worst channel), dB
    met : whether the target was reached
    history : after every pass: seconds so far, error (dB)
    """

    raw: RawData
    image: SarImage
    passes: int
    error_db: float
    met: bool
    history: tuple[tuple[float, float], ...]


@exclusive
def refine(
    scene: SceneLike,
    *,
    target_error_db: float | None = None,
    time_limit: float | None = None,
    state: Path | str | None = None,
    grid: ImageGrid | None = None,
    range_window: str = DEFAULT_WINDOW,
    azimuth_window: str = DEFAULT_WINDOW,
    max_passes: int = 1000,
    progress: Progress | None = None,
    ready: Ready | None = None,
    clock: Clock = time.perf_counter,
    workers: Workers | None = None,
) -> Refinement:
    """Raw data and image from several passes of rays, until the sampling error or the time reaches its limit.

    Every pass traces the scene with new lattices, shifted and rotated at random, and with twice the rays of the
    previous pass as far as memory and time allow: errors common to all lattices of one density fall only with denser
    ones. The result is the mean of all passes, weighted by their rays. The error of the image is estimated from the
    change by the last pass, so that a target needs at least two passes; after one pass it is that of the two subsets.

    Parameters
    ----------
    scene : method ``hybrid`` or ``raw``
    target_error_db : energy of the error over that of the image; default the scene's; 0 = no target
    time_limit : s, of this run; default the scene's; 0 = no limit. At least one pass is made
    state : file that holds the passes between runs; the finished blocks of the current pass are in a second file that
        ends in ``.blocks``. None: no file
    grid : of the image; default that of the scene
    range_window, azimuth_window : of the image
    max_passes : bound on all passes
    progress : called after every pass with the error and, where there is one, the limit
    ready : called once the first pass is planned and fits into memory, before it is traced
    clock : for ``time_limit``
    workers : workers that share the tracing of every pass

    Returns
    -------
    Refinement

    Raises
    ------
    DataError
        Neither a target nor a limit is given, nothing is traced, or the state file belongs to another scene.

    Notes
    -----
    The passes reduce only the error of ray sampling; see
    :func:`sarmitsuba.simulation.execution.error_bars.estimate_pass_error`.
    """
    scene = Scene.of(scene)
    target = scene.settings.target_error_db if target_error_db is None else target_error_db
    limit = scene.settings.time_limit if time_limit is None else time_limit
    if target >= 0.0 and limit <= 0.0:
        raise DataError(
            f"{scene.name}: adding passes needs target_error_db below 0 dB or time_limit above 0 s; set one of them"
        )
    if not scene.traced:
        raise DataError(
            f"{scene.name}: ideal points alone need no rays, and their echoes are exact; leave out target_error_db and "
            "time_limit"
        )
    received = idealise_receiver(scene, switched_off=True).radar
    off: dict[str, Switch] = {effect.name: "off" for effect in EFFECTS if effect.of_receiver}
    quiet = {**scene.settings.effects, **off}
    scene = replace(scene, settings=replace(scene.settings, keep_subsets=True, effects=quiet))
    file = Path(state) if state is not None else None
    run_hash = fingerprint(scene)
    # the sum of all passes is what is received
    noiseless = idealise_receiver(scene)
    whole = Run(noiseless, clock=clock, workers=workers)
    layout = PassLayout.of(whole.scene, whole.layers.layers)
    passes = Passes.load(file, run_hash, layout) if file else Passes(run_hash)
    focuser = _PassImage(
        scene,
        passes,
        grid or default_grid(scene.radar.as_recorded(), scene.image),
        range_window,
        azimuth_window,
    )
    goal = _Goal(target, limit, max_passes, clock)
    took = 0.0  # seconds of the last pass with its check
    while True:
        error, elapsed = np.inf, goal.elapsed
        if passes.data is not None:
            error = focuser.error_db(goal)
            elapsed = goal.elapsed
            info = {"dB error": error} | ({"dB wanted": target} if target < 0.0 else {})
            (progress or silent)("refine", *goal.share(error, elapsed), info)
            passes.history[-1] = (passes.seconds, error)
        level = None if goal.reached(error, passes) else _next_level(passes, took, goal.left(elapsed))
        if level is None:
            break
        start = clock()
        run = whole.at(2.0 ** (-0.5 * level))
        run.needs().of_passes.check()
        if file:
            part = f"pass {passes.count}, level {level}"
            run.finished = FinishedBlocks(blocks_of(file), run_hash, run.plan, part, run.batch_shape)
        try:
            if ready:
                ready(run)
                ready = None
            passes.add(echoes(run, pass_index=passes.count), level)
        finally:
            if run.finished is not None:
                run.finished.close()
        took = clock() - start
        passes.seconds += took
        passes.history.append((passes.seconds, float("nan")))
        if file:
            passes.save(file)
            blocks_of(file).unlink()  # now contained in the pass
    ideal = received.noise_temperature == 0.0 and not received.received
    return _finish_passes(focuser, goal, None if ideal else received)


@dataclass(frozen=True)
class _Goal:
    """Stopping criteria: target error (dB; 0: none), time limit (s; 0: none), largest number of passes."""

    target: float
    limit: float
    max_passes: int
    clock: Clock
    begin: float = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "begin", self.clock())

    @property
    def elapsed(self) -> float:
        return self.clock() - self.begin

    def left(self, elapsed: float) -> float:
        return self.limit - elapsed if self.limit > 0.0 else np.inf

    def met(self, error: float) -> bool:
        return self.target < 0.0 and error <= self.target

    def reached(self, error: float, passes: Passes) -> bool:
        # the error from the subsets of one pass is too uncertain to stop
        return (self.met(error) and passes.count > 1) or passes.count >= self.max_passes

    def share(self, error: float, elapsed: float) -> tuple[float, float]:
        """Progress in per cent: by the passes still needed for the target, or by the time, whichever is larger."""
        by_error = power_from_db((self.target - error) / RAY_ERROR_ORDER) if self.target < 0.0 else 0.0
        by_time = elapsed / self.limit if self.limit > 0.0 else 0.0
        return 100.0 * min(1.0, max(by_error, by_time)), 100.0


class _PassImage:
    """Image of the passes so far, and its error; focused only when needed, else the error of the raw data is used."""

    def __init__(
        self, scene: Scene, passes: Passes, grid: ImageGrid, range_window: str, azimuth_window: str
    ) -> None:
        self.scene, self.passes, self.grid = scene, passes, grid
        self.range_window, self.azimuth_window = range_window, azimuth_window
        self.image: SarImage | None = None  # image of the passes so far, if focused

    def raw(self) -> RawData:
        passes = self.passes
        assert passes.data is not None
        return self._raw(passes.data, passes.layers)

    def _raw(self, data: C64, layers: tuple[Layer, ...]) -> RawData:
        scene, radar = self.scene, self.scene.radar
        flown = radar.track if radar.recorded is not None else None
        return RawData(
            data, layers, "compressed", radar.as_recorded(), self.passes.metadata, scene.image, flown
        )

    def focus(self, raw: RawData) -> SarImage:
        return focus(raw, self.grid, range_window=self.range_window, azimuth_window=self.azimuth_window)

    def bars(self, image: SarImage) -> ErrorBars:
        """Error bars of the image of all passes."""
        change = self.passes.change
        if change is None:
            return estimate_error(image.data, image.layers, pixels=False)
        channels = channels_of(image.layers)
        changed = self.focus(self._raw(change, tuple(Layer(c) for c in channels)))
        mean = sum_layers(image.data, image.layers)
        return estimate_pass_error(changed.data, mean, channels, self.passes.share)

    def _raw_error_db(self) -> float:
        """Error of the raw data, worst channel, dB."""
        passes = self.passes
        assert passes.data is not None
        if passes.change is None:
            return max(estimate_error(passes.data, passes.layers, pixels=False).error_db)
        mean = sum_layers(passes.data, passes.layers)
        channels = channels_of(passes.layers)
        return max(estimate_pass_error(passes.change, mean, channels, passes.share).error_db)

    def error_db(self, goal: _Goal) -> float:
        """Error of the image, worst channel, dB."""
        self.image = None
        raw_error, passes = self._raw_error_db(), self.passes
        source: Source = SUBSETS if passes.change is None else PASSES
        if source != passes.source:  # the ratio depends on the kind of estimate
            passes.ratio_db, passes.source = None, source
        error = self.counting_bias(raw_error + (passes.ratio_db or 0.0))
        if passes.ratio_db is None or (goal.target < 0.0 and error <= goal.target + 0.3):
            self.image = self.focus(self.raw())
            of_image = max(self.bars(self.image).error_db)
            passes.ratio_db = of_image - raw_error
            error = self.counting_bias(of_image)
        return error

    def counting_bias(self, error_db: float) -> float:
        """Error with that of the ray spacing, dB, which all passes share, as measured in the last and densest one."""
        witnesses = self.passes.metadata.get("witnesses")
        found = Witness.read(witnesses.get("rays")) if isinstance(witnesses, Mapping) else None
        return error_db if found is None else exchange_two_sets(found, error_db).error_db


def blocks_of(state: Path) -> Path:
    """Path of the file of finished blocks of the current pass, next to the state file."""
    path = state.with_suffix(".blocks")
    return path if path != state else state.with_suffix(".pass.blocks")


def _finish_passes(focuser: _PassImage, goal: _Goal, received: Radar | None) -> Refinement:
    """Raw data and image of all passes, received last by the radar ``received``; None: an ideal receiver."""
    passes, raw = focuser.passes, focuser.raw()
    image = focuser.image or focuser.focus(raw)
    bars = focuser.bars(image)
    error = focuser.counting_bias(max(bars.error_db))
    passes.history[-1] = (passes.seconds, error)
    if received is not None:
        settings = focuser.scene.settings
        raw = replace(raw, radar=received.as_recorded())
        raw = receive(raw, seed=settings.seed, days=settings.pass_days)
        image = focuser.focus(raw)
    met = goal.met(error)
    record = {
        "passes": passes.count,
        "levels": passes.levels,
        "seconds": passes.seconds,
        "target_error_db": goal.target,
        "time_limit_s": goal.limit,
        "met": met,
        "sampling_error": bars.as_dict(),
        "history": [[round(s, 3), round(e, 3)] for s, e in passes.history],
    }
    raw = replace(raw, metadata={**raw.metadata, "refinement": record})
    image = add_error_bars(replace(image, metadata={**image.metadata, "refinement": record}))
    return Refinement(raw, image, passes.count, error, met, tuple(passes.history))


def _next_level(passes: Passes, took: float, left: float) -> int | None:
    """Density level of the next pass: twice the rays if time and memory allow, else unchanged; None when time is up."""
    if not passes.levels:
        return 0
    level = max(passes.levels)
    if 2.0 * took <= 1.2 * left and passes.rays <= MAX_RAYS:
        return level + 1
    return level if took <= 1.5 * left and left > 0.0 else None
