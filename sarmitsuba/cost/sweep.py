"""One scene under many settings: error against a reference, seconds by stage, memory."""

import sys
import threading
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sarmitsuba.backend import dr
from sarmitsuba.focusing import default_grid, focus
from sarmitsuba.image.metrics import image_error_db
from sarmitsuba.image.sar_image import ImageGrid
from sarmitsuba.scene.scene import Scene
from sarmitsuba.scene.settings import TraceSettings
from sarmitsuba.simulation.image import simulate_image
from sarmitsuba.simulation.raw import simulate

C64 = NDArray[np.complex64]

_TRACE_FIELDS = {f.name for f in fields(TraceSettings)}


@dataclass(frozen=True)
class Setting:
    """What a trial changes about a scene.

    Parameters
    ----------
    changes : fields of ``TraceSettings`` to their values; ``focuser`` (its name) and ``interpolation`` (an
        option of backprojection) beside them
    """

    changes: Mapping[str, Any] = field(default_factory=dict)

    def apply(self, scene: Scene) -> Scene:
        """The scene with these settings."""
        own = {k: v for k, v in self.changes.items() if k in _TRACE_FIELDS}
        return replace(scene, settings=replace(scene.settings, **own))

    def but(self, **changes: Any) -> "Setting":
        """A copy with some values replaced."""
        return Setting({**self.changes, **changes})


@dataclass(frozen=True, eq=False)
class Trial:
    """One run.

    Parameters
    ----------
    setting : that was run
    image : (n_azimuth, n_range) complex64, first channel, orders and subsets summed
    stages : seconds by stage, without compiling
    compile_seconds : spent on compiling kernels
    peak_bytes : growth of the resident memory at its highest; -1 where the system does not say
    facts : ``statistics`` and ``sampling`` of the simulation
    """

    setting: Setting
    image: C64
    stages: Mapping[str, float]
    compile_seconds: float
    peak_bytes: int
    facts: Mapping[str, Any]

    @property
    def seconds(self) -> float:
        """All stages, s."""
        return float(sum(self.stages.values()))

    def error_db(self, reference: NDArray[Any]) -> float:
        """Energy of the difference over that of the reference, dB."""
        return image_error_db(self.image, reference)


def run_trial(scene: Scene, setting: Setting, grid: ImageGrid | None = None, *, pass_index: int = 0) -> Trial:
    """Run a setting; what Dr.Jit spends on compiling is booked apart."""
    return _run(scene, setting, grid, pass_index)


def _run(scene: Scene, setting: Setting, grid: ImageGrid | None, pass_index: int) -> Trial:
    changed = setting.apply(scene)
    grid = grid or default_grid(scene.radar, scene.image)
    compiled = 0.0
    with memory() as peak:
        if changed.settings.method in ("image", "raster"):
            with compiling() as spent:
                image = simulate_image(changed, grid=grid, pass_index=pass_index)
            stages = dict(image.metadata["seconds"])
            compiled += _take(stages, spent[0], ("trace", "raster", "plan"))
        else:
            with compiling() as spent:
                raw = simulate(changed, pass_index=pass_index)
            stages = dict(raw.metadata["seconds"])
            compiled += _take(stages, spent[0], ("trace", "plan", "points"))
            focuser = str(setting.changes.get("focuser", "backprojection"))
            if "interpolation" in setting.changes:
                focuser += f",interpolation={setting.changes['interpolation']}"
            start = time.perf_counter()
            with compiling() as spent:
                image = focus(
                    raw,
                    grid,
                    focuser=focuser,
                )
            stages["focus"] = time.perf_counter() - start
            compiled += _take(stages, spent[0], ("focus",))
    facts = {k: image.metadata.get(k, {}) for k in ("statistics", "sampling")}
    return Trial(setting, image.total(), stages, compiled, peak[0], facts)


@contextmanager
def compiling() -> Iterator[list[float]]:
    """Measure what Dr.Jit spends on compiling kernels within the block; yields ``[seconds]``."""
    spent = [0.0]
    flag = dr.JitFlag.KernelHistory
    before = dr.flag(flag)
    dr.set_flag(flag, True)
    dr.kernel_history_clear()
    try:
        yield spent
    finally:
        history = dr.kernel_history()
        dr.kernel_history_clear()
        dr.set_flag(flag, before)
        spent[0] = 1e-3 * sum(
            float(entry.get("codegen_time", 0.0)) + float(entry.get("backend_time", 0.0)) for entry in history
        )


def _take(stages: dict[str, float], seconds: float, names: tuple[str, ...]) -> float:
    """Subtract compiling from the stages that compile, the first as far as it goes, then the next."""
    left = seconds
    for name in names:
        part = min(left, stages.get(name, 0.0))
        if part > 0.0:
            stages[name] -= part
            left -= part
    return seconds - left


def mean_image(scene: Scene, setting: Setting, grid: ImageGrid, passes: int, first_pass: int = 1000) -> C64:
    """Mean of passes whose lattices no trial shares: the reference that trials are measured against."""
    total = np.zeros(grid.shape, dtype=np.complex128)
    for index in range(passes):
        total += _run(scene, setting, grid, first_pass + index).image
    return (total / passes).astype(np.complex64)


@contextmanager
def memory() -> Iterator[list[int]]:
    """Watch the resident memory of this process while the block runs; yields ``[growth in bytes]``, -1 unknown."""
    peak = [-1]
    if not sys.platform.startswith("linux"):
        yield peak
        return
    flush_caches()
    statm, page = Path("/proc/self/statm"), 4096
    base = int(statm.read_text().split()[1]) * page
    done = threading.Event()

    def watch() -> None:
        while not done.wait(0.01):
            peak[0] = max(peak[0], int(statm.read_text().split()[1]) * page - base)

    watcher = threading.Thread(target=watch, daemon=True)
    watcher.start()
    try:
        yield peak
    finally:
        done.set()
        watcher.join()


def flush_caches() -> None:
    """Give Dr.Jit's pooled memory back, so that the next run's own shows."""
    if "drjit" not in sys.modules:
        return
    import drjit

    drjit.flush_malloc_cache()


def crop(scene: Scene, share: float, pulses: float = 1.0) -> Scene:
    """The middle of the image (``share`` of each extent), seen by the middle of the aperture (``pulses`` of it)."""
    from sarmitsuba.radar.antenna import Pointing

    image = replace(
        scene.image,
        extent_azimuth=scene.image.extent_azimuth * share,
        extent_range=scene.image.extent_range * share,
    )
    radar = scene.radar
    n = radar.track.n_pulses
    kept = max(2, round(n * pulses))
    start = (n - kept) // 2
    pick = slice(start, start + kept)
    pointing = Pointing(
        radar.pointing.boresight[pick], radar.pointing.azimuth_axis[pick], radar.pointing.elevation_axis[pick]
    )
    window = replace(radar.window, start_range=radar.window.start_range[pick])
    radar = replace(radar, track=radar.track.slice(start, start + kept), pointing=pointing, window=window)
    return replace(scene, image=image, radar=radar)


__all__ = ["Setting", "Trial", "compiling", "crop", "flush_caches", "mean_image", "memory", "run_trial"]
