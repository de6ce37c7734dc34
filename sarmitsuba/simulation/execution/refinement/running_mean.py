"""Running mean of the passes of a run, and the file that stores it between runs."""

import dataclasses
import json
import math
import os
import struct
import tokenize
import zipfile
import zlib
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeVar

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

from sarmitsuba.core.arrays import C64, check_pulses
from sarmitsuba.core.errors import DataError
from sarmitsuba.machine.atomic import atomic_path
from sarmitsuba.machine.encoding import json_value, to_json
from sarmitsuba.machine.regular_files import open_regular
from sarmitsuba.machine.unfinished import offer_resuming
from sarmitsuba.scene.scene import Scene
from sarmitsuba.signal.raw.raw_data import Layer, RawData, channels_of, sum_of_channel
from sarmitsuba.simulation.execution.refinement.error_bars import PASSES, SUBSETS, Source

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


def sum_layers(data: C64, layers: Sequence[Layer]) -> C64:
    """Sum of the layers of every channel, (n_channels, ...)."""
    return np.stack([sum_of_channel(data, layers, c, "passes") for c in channels_of(layers)])
