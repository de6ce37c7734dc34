"""Choice and start of the Dr.Jit back end: search for a working LLVM (or a GPU) and Mitsuba's variant, on demand.

Compiled kernels are kept in the home folder, or in another one if that is not writable.
"""

import ctypes
import importlib
import importlib.metadata
import os
import platform
import re
import stat
import sys
import tempfile
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from sarmitsuba.core.arrays import F64
from sarmitsuba.core.errors import BackendError, SarmitsubaWarning
from sarmitsuba.machine.exclusive import check_backend_kept
from sarmitsuba.machine.memory import check_limits, share_one_heap

if TYPE_CHECKING:
    import drjit as dr
    import mitsuba as mi

    Array = TypeVar("Array")


CACHE_VARIABLE = "DRJIT_CACHE_DIR"


def prepare_kernel_cache() -> Path | None:
    """Choose another folder for compiled kernels if Dr.Jit's is unusable; call before importing Dr.Jit.

    A folder named by ``DRJIT_CACHE_DIR`` is not changed. A ``~/.drjit`` that is not writable, is a link, or is owned or
    writable by others is replaced by a private folder of this user among the temporary files, which is kept from run to
    run; a folder that others could have filled is not used, because kernels are code.

    Returns
    -------
    the folder; None: no choice was needed

    Warns
    -----
    SarmitsubaWarning
        Once, with the chosen folder.
    """
    if os.environ.get(CACHE_VARIABLE) or os.name != "posix":
        return None
    home = os.environ.get("HOME", "")
    usual = Path(home) / ".drjit"
    reason = (
        ""
        if home and _own(usual) and _writable(usual)
        else _reason(usual)
        if home
        else "there is no home folder"
    )
    if not reason:
        return None
    folder = Path(tempfile.gettempdir()) / f"sarmitsuba-kernels-{os.getuid()}"
    if not _own(folder):
        folder = Path(tempfile.mkdtemp(prefix="sarmitsuba-kernels-"))
    os.environ[CACHE_VARIABLE] = str(folder)
    warnings.warn(
        f"compiled kernels are kept in {folder}, because {reason}; set {CACHE_VARIABLE} for another place",
        SarmitsubaWarning,
        stacklevel=2,
    )
    return folder


def _writable(folder: Path) -> bool:
    """Whether files can be created in the folder, which is created if needed."""
    try:
        folder.mkdir(exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            return True
    except OSError:
        return False


def _reason(folder: Path) -> str:
    """Reason why a folder cannot be used."""
    try:
        found = folder.lstat()
    except OSError:
        return f"{folder.parent} cannot be written"
    if not stat.S_ISDIR(found.st_mode):
        return f"{folder} is no folder"
    if not _private(found):
        return f"others can write in {folder} (chmod go-w it)"
    return f"{folder} cannot be written"


def _own(folder: Path) -> bool:
    """Whether the folder, created if needed, is private to this user and no link."""
    try:
        folder.mkdir(mode=0o700, exist_ok=True)
        found = folder.lstat()
    except OSError:
        return False
    return stat.S_ISDIR(found.st_mode) and _private(found)


def _private(found: os.stat_result) -> bool:
    """Whether a folder is owned and writable by this user only; a group of the user's number counts as the user."""
    others = stat.S_IWOTH if found.st_gid == found.st_uid else stat.S_IWOTH | stat.S_IWGRP
    return found.st_uid == os.getuid() and not found.st_mode & others


LLVM_PACKAGE = "karellen-llvm-core"
LLVM_VARIABLE = "DRJIT_LIBLLVM_PATH"  # read by Dr.Jit when it is first imported
VARIANT_VARIABLE = "SARMITSUBA_VARIANT"
LLVM_VARIANT = "llvm_ad_rgb"
CUDA_VARIANT = "cuda_ad_rgb"

# Dr.Jit 1.5 needs 15; 15 cannot select "fminimum" on machines with AVX-512
_OLDEST_LLVM = 15
_OLDEST_LLVM_AVX512 = 16

_SYSTEM_FOLDERS = (
    "/usr/lib/llvm-*/lib",
    "/usr/lib/*-linux-gnu",
    "/usr/lib64/llvm*/lib",
    "/usr/lib64",
    "/usr/lib",
    "/usr/local/lib",
    "/opt/homebrew/opt/llvm*/lib",
    "/usr/local/opt/llvm*/lib",
)
_LLVM_NAME = re.compile(r"libLLVM(?:-C)?(?:[-.](?P<a>\d+)[\d.]*)?\.(?:so|dylib)(?:\.(?P<b>\d+)[\d.]*)?$")

# mangled names of Dr.Jit's shutdown and start functions, Linux and macOS
_STOP, _START = "_Z12jit_shutdowni", "_Z8jit_initj"

REMEDY = (
    f"pip install '{LLVM_PACKAGE}>=19,<24' (x86-64 Linux), or install LLVM >= {_OLDEST_LLVM_AVX512} with the "
    f"system's package manager and point {LLVM_VARIABLE} at its libLLVM.so"
)


@dataclass(frozen=True)
class Backend:
    """Back end of the kernels.

    Parameters
    ----------
    variant : present Mitsuba variant
    llvm_path : LLVM library given to Dr.Jit; None on a GPU or where Dr.Jit found one
    llvm_version : as Dr.Jit reports it, e.g. ``23.1.4``; None on a GPU
    threads : worker threads of Dr.Jit
    gpu : description by CUDA; None without a usable GPU
    """

    variant: str
    llvm_path: Path | None
    llvm_version: str | None
    threads: int
    gpu: str | None


@dataclass(frozen=True)
class LlvmChoice:
    """LLVM library with its origin: ``environment``, ``package`` or ``system``."""

    path: Path
    source: str
    version: str | None


def ensure_backend(prefer: str | None = None) -> Backend:
    """Start Dr.Jit and Mitsuba for tracing; may be called repeatedly.

    The variant is, in this order: one that is already set and can trace (``llvm_*`` or ``cuda_*``), ``prefer``,
    the environment variable ``SARMITSUBA_VARIANT``, ``cuda_ad_rgb`` where an NVIDIA GPU with OptiX works, and
    ``llvm_ad_rgb``; a scalar variant, which cannot trace, is replaced with a warning. Dr.Jit searches for LLVM on
    import: if Mitsuba was imported first and the LLVM found then is unusable, Dr.Jit is restarted with a usable one,
    unless it already holds computed arrays.

    Parameters
    ----------
    prefer : Mitsuba variant, or None

    Raises
    ------
    ResourceError
        Limits of the system leave no room for its threads and libraries.
    BackendError
        No back end works, or the requested variant does not exist or cannot start.
    """
    check_backend_kept()
    share_one_heap()
    late = "drjit" in sys.modules
    if not late:
        check_limits()
        _check_folder()
    choice = None if late else prepare_llvm()
    if not late:
        prepare_kernel_cache()
    mi, dr = _import_mitsuba()
    current = mi.variant()
    if late and not (current or "").startswith("cuda_"):
        choice = _replace_llvm(dr)
    if current is None or not current.startswith(("llvm_", "cuda_")):
        wanted = prefer or os.environ.get(VARIANT_VARIABLE) or None
        replaced, current = current, _start(mi, dr, wanted, choice)
        if replaced is not None:
            warnings.warn(
                f"Mitsuba's variant {replaced} traces no radar paths and is replaced by {current}; objects made under "
                "it are of another type, and mi.set_variant brings it back",
                SarmitsubaWarning,
                stacklevel=3,
            )
    on_gpu = current.startswith("cuda_")
    path = os.environ.get(LLVM_VARIABLE)
    version = None if on_gpu else llvm_version()
    _refuse_old_llvm(version)
    return Backend(
        variant=current,
        llvm_path=Path(path) if path and not on_gpu else None,
        llvm_version=version,
        threads=int(dr.thread_count()),
        gpu=gpu_description() if on_gpu else None,
    )


def _check_folder() -> None:
    """Raise a BackendError in a deleted working folder, in which Mitsuba ends the process."""
    try:
        os.getcwd()
    except OSError as error:
        raise BackendError(
            f"the working folder is gone ({error.strerror}); change to another folder"
        ) from error


def _refuse_old_llvm(version: str | None) -> None:
    """Raise a BackendError where the LLVM that Dr.Jit has loaded cannot compile for this processor."""
    if version and int(version.partition(".")[0]) < _OLDEST_LLVM_AVX512 and has_avx512():
        # it would end the process at the first kernel: "LLVM ERROR: Cannot select: fminimum"
        raise BackendError(
            f"LLVM {version} cannot compile for this processor (AVX-512), and Dr.Jit uses it already; call "
            f"sarmitsuba.register_plugins() before mi.set_variant, or set {LLVM_VARIABLE} to an LLVM >= "
            f"{_OLDEST_LLVM_AVX512}"
        )


def prepare_llvm() -> LlvmChoice | None:
    """Set ``DRJIT_LIBLLVM_PATH`` to a usable LLVM, unless the user did; return the choice, None if none was found."""
    choice = find_llvm()
    if choice is not None and choice.source != "environment":
        if choice.source == "package":
            _preload_libcxx(choice.path)
        os.environ[LLVM_VARIABLE] = str(choice.path)
    return choice


def _replace_llvm(dr: ModuleType) -> LlvmChoice | None:
    """Restart Dr.Jit with a usable LLVM if the one found on import is unusable.

    Nothing is done if the user chose the library, if Dr.Jit holds variables (they would be lost) or a GPU, or if its
    start and shutdown cannot be called. Returns the usable LLVM, None where none is needed or known.
    """
    version = llvm_version()
    major = int(version.partition(".")[0]) if version else 0
    if dr.has_backend(dr.JitBackend.LLVM) and not (major < _OLDEST_LLVM_AVX512 and has_avx512()):
        return None
    choice = find_llvm()
    at_work = dr.has_backend(dr.JitBackend.CUDA) or "No variables" not in dr.whos(as_string=True)
    if choice is None or choice.source == "environment" or at_work:
        return choice
    try:
        core = ctypes.CDLL(str(next(Path(str(dr.__file__)).parent.glob("libdrjit-core.*"))))
        stop, start = core[_STOP], core[_START]
    except (AttributeError, OSError, StopIteration):
        return choice
    stop.restype = start.restype = None
    prepare_llvm()
    stop(ctypes.c_int(0))
    start(ctypes.c_uint32(1 << int(dr.JitBackend.LLVM.value)))
    return choice


def find_llvm() -> LlvmChoice | None:
    """Search for LLVM: the user's variable, then the PyPI package, then the system; changes nothing."""
    own = os.environ.get(LLVM_VARIABLE)
    if own:
        return LlvmChoice(Path(own), "environment", None)
    return _packaged_llvm() or _system_llvm()


def llvm_version() -> str | None:
    """Version of the LLVM that Dr.Jit loaded, None if it loaded none."""
    import drjit.detail

    try:
        return _format_version(drjit.detail.llvm_version())
    except (AttributeError, RuntimeError):
        return None


def gpu_description() -> str | None:
    """One line about the NVIDIA GPU if Dr.Jit can use it for rays, else None; imports Dr.Jit."""
    import drjit as dr

    if not dr.has_backend(dr.JitBackend.CUDA) or not _has_optix():
        return None
    try:
        version = _format_version(dr.detail.cuda_version())
    except (AttributeError, RuntimeError):
        version = "unknown version"
    return f"NVIDIA GPU, CUDA driver {version}"


def _format_version(version: Any) -> str:
    return ".".join(str(part) for part in version) if isinstance(version, (tuple, list)) else str(version)


def _import_mitsuba() -> tuple[Any, Any]:
    try:
        import drjit as dr
        import mitsuba as mi
    except ImportError as error:
        raise BackendError(f"Mitsuba cannot be imported: {error}; pip install mitsuba==3.9.1") from error
    return mi, dr


def _start(mi: Any, dr: Any, wanted: str | None, choice: LlvmChoice | None) -> str:
    """Set the wanted variant, or the best one, and return its name."""
    if wanted is not None:
        usable = [v for v in mi.variants() if v.startswith(("llvm_ad", "cuda_ad"))]
        if wanted not in usable:
            raise BackendError(f"variant {wanted!r} cannot trace radar paths; use one of {', '.join(usable)}")
    if wanted is None:
        wanted = CUDA_VARIANT if gpu_description() else LLVM_VARIANT
    if wanted.startswith("cuda_"):
        if gpu_description() is None:
            raise BackendError(
                f"variant {wanted!r} needs an NVIDIA GPU with its driver and OptiX; none works here"
            )
    elif not dr.has_backend(dr.JitBackend.LLVM):
        raise BackendError(_no_llvm(choice))
    mi.set_variant(wanted)
    return wanted


class _Lazy:
    """Module of the back end, imported and started at the first use of an attribute.

    Attributes are cached, so that recording a kernel costs no more than with the module itself; those of Mitsuba depend
    on the variant and are dropped when it changes.
    """

    def __init__(self, name: str) -> None:
        self._module_name = name

    def __getattr__(self, attribute: str) -> Any:
        if attribute.startswith("__"):
            raise AttributeError(attribute)
        check_backend_kept()
        if self._module_name == "mitsuba":
            ensure_backend()
        elif "drjit" not in sys.modules:
            prepare_llvm()
            prepare_kernel_cache()
        module = importlib.import_module(self._module_name)
        if "_watched" not in self.__dict__ and self._module_name == "mitsuba":
            self.__dict__["_watched"] = True
            module.detail.add_variant_callback(self._forget)
        value = self.__dict__[attribute] = getattr(module, attribute)
        return value

    def _forget(self, old: str | None = None, new: str | None = None) -> None:
        for name in [n for n in self.__dict__ if not n.startswith("_")]:
            del self.__dict__[name]


if not TYPE_CHECKING:
    # the only import of Dr.Jit and Mitsuba; their array types depend on the variant
    dr, mi = _Lazy("drjit"), _Lazy("mitsuba")
    if hasattr(os, "register_at_fork"):  # what a fork lost is asked for again, and refused
        os.register_at_fork(after_in_child=dr._forget)
        os.register_at_fork(after_in_child=mi._forget)


def _no_llvm(choice: LlvmChoice | None) -> str:
    own = os.environ.get(LLVM_VARIABLE)
    if own:
        return f"{LLVM_VARIABLE} = {own}: Dr.Jit cannot use this LLVM library; unset it, or {REMEDY}"
    if choice is None and find_llvm() is not None:
        return "Mitsuba was imported before an LLVM was found; call sarmitsuba.register_plugins() before importing it"
    return f"no LLVM library of version {_OLDEST_LLVM} or later was found; {REMEDY}"


def _packaged_llvm() -> LlvmChoice | None:
    """Find libLLVM among the files of the PyPI package, wherever pip put them."""
    try:
        distribution = importlib.metadata.distribution(LLVM_PACKAGE)
    except importlib.metadata.PackageNotFoundError:
        return None
    found = {
        Path(os.path.normpath(str(distribution.locate_file(file))))
        for file in distribution.files or ()
        if _LLVM_NAME.fullmatch(file.name)
    }
    # the link libLLVM.so exists only after the interpreter's first start: the shortest name that exists
    existing = sorted((path for path in found if os.path.exists(path)), key=lambda path: len(path.name))
    if not existing:
        return None
    return LlvmChoice(existing[0], "package", distribution.version)


def _preload_libcxx(llvm: Path) -> None:
    """Load the package's libc++ and its dependencies by their full names where the links to them are missing.

    The links are made by ``wheel-axle-runtime`` at the first start of the interpreter, which fails when that
    start may not write to the environment (installed by root, run by a user).
    """
    for folder in llvm.parent.glob("*-linux-gnu"):
        for name in ("libunwind.so.1", "libc++abi.so.1", "libc++.so.1"):  # each needs those before it
            full = folder / f"{name}.0"
            if os.path.exists(full) and not os.path.exists(folder / name):
                try:
                    ctypes.CDLL(str(full))  # local: a global libunwind would catch Mitsuba's exceptions
                except OSError:
                    return  # Dr.Jit's own attempt then fails and is reported


def _system_llvm(root: Path = Path("/")) -> LlvmChoice | None:
    """Newest LLVM library of the system that Dr.Jit can work with on this processor."""
    oldest = _OLDEST_LLVM_AVX512 if has_avx512() else _OLDEST_LLVM
    best: tuple[int, Path] | None = None
    for pattern in _SYSTEM_FOLDERS:
        for path in sorted(root.glob(f"{pattern[1:]}/libLLVM*")):
            version = _library_version(path)
            if version is None or version < oldest or not os.path.exists(path):
                continue
            if best is None or version > best[0]:
                best = (version, path)
    return None if best is None else LlvmChoice(best[1], "system", str(best[0]))


def _library_version(path: Path) -> int | None:
    """Major version of a libLLVM from its name, the file it links to, or its folder; None if unknown."""
    if _LLVM_NAME.fullmatch(path.name) is None:
        return None
    for name in (path.name, path.resolve().name):
        match = _LLVM_NAME.fullmatch(name)
        if match is not None and (match["a"] or match["b"]):
            return int(match["a"] or match["b"])
    folder = _folder_version(path)
    return int(folder) if folder else None


def _folder_version(path: Path) -> str | None:
    match = re.search(r"llvm[@-]?(\d+)", str(path.parent))
    return match[1] if match else None


def has_avx512() -> bool:
    """Whether /proc/cpuinfo lists AVX-512 (x86-64)."""
    if platform.machine().lower() not in {"x86_64", "amd64"}:
        return False
    try:
        return "avx512" in Path("/proc/cpuinfo").read_text(encoding="ascii", errors="replace")
    except OSError:
        return False


def _has_optix() -> bool:
    """Whether the ray tracing library of the NVIDIA driver exists (containers often lack it)."""
    if sys.platform != "linux":
        return True
    try:
        ctypes.CDLL("libnvoptix.so.1")
    except OSError:
        return False
    return True


def arrays() -> ModuleType:
    """Dr.Jit's array types for kernels that trace no rays: ``drjit.llvm`` or ``drjit.cuda``, without Mitsuba.

    If Mitsuba is running its variant decides; otherwise the choice is that of :func:`ensure_backend`.

    Raises
    ------
    BackendError
        No back end works.
    """
    check_backend_kept()
    late = "drjit" in sys.modules
    choice = None if late else prepare_llvm()
    try:
        import drjit
    except ImportError as error:
        raise BackendError(f"Dr.Jit cannot be imported: {error}; pip install drjit==1.5.0") from error
    mitsuba = sys.modules.get("mitsuba")
    asked = (mitsuba.variant() if mitsuba else None, os.environ.get(VARIANT_VARIABLE))
    usable = [variant for variant in asked if variant and variant.startswith(("llvm_", "cuda_"))]
    variant = usable[0] if usable else CUDA_VARIANT if gpu_description() else LLVM_VARIANT
    if variant.startswith("cuda_"):
        if not drjit.has_backend(drjit.JitBackend.CUDA):
            raise BackendError(f"variant {variant!r} needs an NVIDIA GPU with its driver; none works here")
        return importlib.import_module("drjit.cuda")
    if late:
        choice = _replace_llvm(drjit)
    if not drjit.has_backend(drjit.JitBackend.LLVM):
        raise BackendError(_no_llvm(choice))
    _refuse_old_llvm(llvm_version())
    return importlib.import_module("drjit.llvm")


# alignment, bytes: a multiple of the widest vector of a processor, 16 or 32 float64
_ALIGNMENT = 256


def device_array(array_type: "type[Array]", values: NDArray[np.generic]) -> "Array":
    """Copy a NumPy array, flattened, into a Dr.Jit array of ``array_type``; the items' types must agree.

    Dr.Jit uses the memory of a NumPy array directly, and the kernel depends on whether its address is aligned: without
    the copy the same code would occasionally be compiled again.
    """
    flat = np.ascontiguousarray(values).reshape(-1)
    memory = np.empty(flat.nbytes + _ALIGNMENT, dtype=np.uint8)
    start = -memory.ctypes.data % _ALIGNMENT
    aligned = memory[start : start + flat.nbytes].view(flat.dtype)
    aligned[...] = flat
    return array_type(aligned)  # type: ignore[call-arg]


def device_numbers(array_type: "type[Array]", numbers: "Sequence[float | F64]") -> "tuple[Array, ...]":
    """Numbers and tables of a formula as opaque float32 arrays, so that one kernel serves all values."""
    return tuple(
        device_array(array_type, np.asarray(number, dtype=np.float32))
        if isinstance(number, np.ndarray)
        else dr.opaque(array_type, number)
        for number in numbers
    )


__all__ = [
    "Backend",
    "LlvmChoice",
    "arrays",
    "device_array",
    "device_numbers",
    "dr",
    "ensure_backend",
    "find_llvm",
    "gpu_description",
    "llvm_version",
    "mi",
    "prepare_llvm",
]
