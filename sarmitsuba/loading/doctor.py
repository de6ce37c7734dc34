"""Check of the machine: versions, back end and ray rate, with installation advice for missing parts."""

import importlib.metadata
import os
import platform
import statistics
import sys
import time
from dataclasses import dataclass

from sarmitsuba.core.errors import SarmitsubaError
from sarmitsuba.machine.backend import Backend, dr, ensure_backend, gpu_description, mi

_PINNED = {"mitsuba": "3.9.1", "drjit": "1.5.0"}
_NEEDED = ("numpy", "scipy", "trimesh", "OpenEXR", "matplotlib", "h5py", "threadpoolctl", "tqdm")
_N_RAYS = 1 << 20


@dataclass(frozen=True)
class Check:
    """Result of one check.

    Parameters
    ----------
    name : checked item
    value : result
    ok : whether the check passed
    essential : whether the program needs it
    remedy : installation advice; empty if not needed
    """

    name: str
    value: str
    ok: bool = True
    essential: bool = False
    remedy: str = ""


@dataclass(frozen=True)
class Report:
    """Results of all checks, and the ray rate, rays/s (0: not measured)."""

    checks: tuple[Check, ...]
    ray_rate: float

    @property
    def ok(self) -> bool:
        """Whether all essential checks passed."""
        return all(check.ok for check in self.checks if check.essential)


def examine(*, seconds: float = 1.0) -> Report:
    """Results of all checks of this machine; measuring the ray rate takes ``seconds`` plus the start of Mitsuba."""
    checks = [_python(), _processor(), *_packages()]
    rate = 0.0
    try:
        backend = ensure_backend()
    except SarmitsubaError as error:
        text = str(error)
        checks.append(Check("back end", "none works here", ok=False, essential=True, remedy=text))
    else:
        checks += _backend(backend)
        rate = measure_ray_rate(seconds)
        checks.append(Check("ray rate", f"{rate / 1e6:.1f} million rays/s (64 boxes on a plane)"))
    checks.append(_library())
    checks.append(
        _optional(
            "sionna-rt",
            "optional, only for the Munich scene: pip install sionna-rt==2.2.0 (needs Python >= 3.11)",
        )
    )
    return Report(tuple(checks), rate)


def measure_ray_rate(seconds: float = 1.0) -> float:
    """Return the median rate of ray queries in a small scene of boxes on a plane, rays/s, without compile time."""
    transform = mi.ScalarTransform4f
    scene: dict[str, object] = {
        "type": "scene",
        "ground": {"type": "rectangle", "to_world": transform().scale(60)},
    }
    for i in range(64):
        place = transform().translate([12.0 * (i % 8) - 42.0, 12.0 * (i // 8) - 42.0, 2.0 + i % 5])
        scene[f"box{i}"] = {"type": "cube", "to_world": place.scale([4.0, 4.0, 2.0 + i % 5])}
    loaded = mi.load_dict(scene)

    def trace(seed: int) -> None:
        sampler = mi.load_dict({"type": "independent"})
        sampler.seed(seed, _N_RAYS)
        point = sampler.next_2d() * 100.0 - 50.0
        ray = mi.Ray3f(mi.Point3f(point.x, point.y, 100.0), mi.Vector3f(0.0, 0.0, -1.0))
        dr.eval(loaded.ray_intersect_preliminary(ray, coherent=False))
        dr.sync_thread()

    trace(0)
    rates: list[float] = []
    start = time.perf_counter()
    while len(rates) < 3 or time.perf_counter() - start < seconds:
        before = time.perf_counter()
        trace(len(rates) + 1)
        rates.append(_N_RAYS / (time.perf_counter() - before))
    return statistics.median(rates)


def _python() -> Check:
    ok = sys.version_info >= (3, 10)
    remedy = "" if ok else "install Python 3.10 or later"
    return Check("Python", f"{platform.python_version()} ({sys.executable})", ok, True, remedy)


def _processor() -> Check:
    count = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    return Check("machine", f"{platform.system()} {platform.machine()}, {count} processors")


def _packages() -> list[Check]:
    checks = []
    for name, wanted in _PINNED.items():
        found = _version(name)
        ok = found == wanted
        checks.append(
            Check(name, found or "missing", ok, True, "" if ok else f"pip install {name}=={wanted}")
        )
    for name in _NEEDED:
        found = _version(name)
        checks.append(
            Check(name, found or "missing", bool(found), True, "" if found else f"pip install {name}")
        )
    return checks


def _backend(backend: Backend) -> list[Check]:
    checks = [Check("back end", backend.variant, essential=True), Check("threads", str(backend.threads))]
    if backend.llvm_version:
        where = backend.llvm_path or "found by Dr.Jit"
        checks.append(Check("LLVM", f"{backend.llvm_version} ({where})"))
    gpu = gpu_description()
    remedy = (
        "" if gpu else "not needed; to use an NVIDIA GPU, install its driver with OptiX (libnvoptix.so.1)"
    )
    checks.append(Check("GPU", gpu or "none usable", True, False, remedy))
    return checks


def _library() -> Check:
    from sarmitsuba.loading.library import list_scenes

    try:
        names = [entry.name for entry in list_scenes()]
    except SarmitsubaError as error:
        return Check("scenes", "missing", False, True, str(error))
    return Check(
        "scenes",
        f"{len(names)} shipped",
        bool(names),
        True,
        "" if names else "install sarmitsuba again; its scenes folder is empty",
    )


def _optional(name: str, remedy: str) -> Check:
    found = _version(name)
    return Check(name, found or "not installed", True, False, "" if found else remedy)


def _version(name: str) -> str | None:
    try:
        return importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError:
        return None
