"""The back end is found, kept and, where there is none, explained."""

import os
import re
import shutil
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from sarmitsuba.core.errors import ResourceError
from sarmitsuba.machine import backend
from sarmitsuba.machine.backend import LlvmChoice, find_llvm
from sarmitsuba.machine.memory import check_limits


def folder_with(root: Path, *names: str) -> None:
    for name in names:
        path = root / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.touch()


def test_the_users_own_variable_wins(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("DRJIT_LIBLLVM_PATH", "/opt/mine.so")
    assert find_llvm() == LlvmChoice(Path("/opt/mine.so"), "environment", None)


def test_then_the_package_then_the_system(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("DRJIT_LIBLLVM_PATH", raising=False)
    package = LlvmChoice(Path("/p.so"), "package", "23")
    system = LlvmChoice(Path("/s.so"), "system", "19")
    monkeypatch.setattr(backend, "_packaged_llvm", lambda: package)
    monkeypatch.setattr(backend, "_system_llvm", lambda: system)
    assert find_llvm() == package
    monkeypatch.setattr(backend, "_packaged_llvm", lambda: None)
    assert find_llvm() == system


@pytest.mark.parametrize(
    ("avx512", "names", "expected"),
    [
        (False, ["usr/lib/x86_64-linux-gnu/libLLVM-14.so.1"], None),
        (False, ["usr/lib/x86_64-linux-gnu/libLLVM-15.so.1"], "15"),
        (True, ["usr/lib/x86_64-linux-gnu/libLLVM-15.so.1"], None),
        (True, ["usr/lib/llvm-16/lib/libLLVM.so", "usr/lib/llvm-19/lib/libLLVM.so.19.1"], "19"),
        (True, ["usr/lib64/libLLVM.so.18.1", "usr/lib64/libLLVM-9.so"], "18"),
        (False, ["opt/homebrew/opt/llvm@17/lib/libLLVM.dylib"], "17"),
        (False, ["usr/lib64/libLLVM.so"], None),
        (False, ["usr/lib64/libLLVMCore.so.19"], None),
    ],
)
def test_newest_working_system_library_is_taken(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, avx512: bool, names: list[str], expected: str | None
) -> None:
    monkeypatch.setattr(backend, "has_avx512", lambda: avx512)
    folder_with(tmp_path, *names)
    choice = backend._system_llvm(tmp_path)
    assert (choice.version if choice else None) == expected


def test_version_is_read_through_links(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(backend, "has_avx512", lambda: True)
    folder_with(tmp_path, "usr/lib64/libLLVM.so.20.1")
    (tmp_path / "usr/lib64/libLLVM.so").symlink_to("libLLVM.so.20.1")
    (tmp_path / "usr/lib/libLLVM.so").parent.mkdir(exist_ok=True)
    (tmp_path / "usr/lib/libLLVM.so").symlink_to("gone.so.21.1")
    choice = backend._system_llvm(tmp_path)
    assert choice is not None and choice.version == "20" and choice.path.exists()


def run(code: str, **environment: str) -> subprocess.CompletedProcess[str]:
    clean = {k: v for k, v in os.environ.items() if k not in ("DRJIT_LIBLLVM_PATH", "SARMITSUBA_VARIANT")}
    return subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, env={**clean, **environment}
    )


SHOW = (
    "from sarmitsuba.machine.backend import ensure_backend as e; b = e(); assert b == e(); print(b.variant)"
)


def test_a_fresh_process_gets_a_variant_that_computes() -> None:
    code = SHOW + "; import drjit as dr, mitsuba as mi; print(dr.sum(dr.arange(mi.Float, 5))[0])"
    result = run(code, SARMITSUBA_VARIANT="llvm_ad_rgb")
    assert result.stdout.split() == ["llvm_ad_rgb", "10.0"], result.stderr


def test_a_variant_that_can_trace_is_kept() -> None:
    before = "from sarmitsuba.machine.backend import prepare_llvm; prepare_llvm(); import mitsuba as mi; "
    result = run(before + "mi.set_variant('llvm_ad_spectral'); " + SHOW)
    assert result.stdout.strip() == "llvm_ad_spectral", result.stderr
    result = run(before + "mi.set_variant('scalar_rgb'); " + SHOW, SARMITSUBA_VARIANT="llvm_ad_rgb")
    assert result.stdout.strip() == "llvm_ad_rgb", result.stderr


@pytest.mark.parametrize(
    "first", ["import drjit", "import mitsuba", "import mitsuba as mi; mi.set_variant('scalar_rgb')"]
)
def test_mitsuba_may_be_imported_first(first: str) -> None:
    """Dr.Jit then has the system's LLVM or none: it is given one that works."""
    least = (
        "print(dr.max(dr.minimum(dr.arange(mi.Float, 9), 5))[0])"  # what LLVM 15 cannot compile with AVX-512
    )
    code = f"{first}; {SHOW}; import drjit as dr, mitsuba as mi; {least}"
    result = run(code, SARMITSUBA_VARIANT="llvm_ad_rgb")
    assert result.stdout.split() == ["llvm_ad_rgb", "5.0"], result.stderr


def test_focusing_may_follow_a_late_start() -> None:
    code = "import drjit as dr; from sarmitsuba.machine.backend import arrays; print(dr.sum(arrays().Float([1, 2]))[0])"
    result = run(code, SARMITSUBA_VARIANT="llvm_ad_rgb")
    assert result.stdout.split() == ["3.0"], result.stderr


@pytest.mark.parametrize(
    ("environment", "text"),
    [
        (
            {"SARMITSUBA_VARIANT": "scalar_rgb"},
            "variant 'scalar_rgb' cannot trace radar paths; use one of llvm_ad_rgb",
        ),
        (
            {"DRJIT_LIBLLVM_PATH": "/none.so", "SARMITSUBA_VARIANT": "llvm_ad_rgb"},
            "/none.so: Dr.Jit cannot use this",
        ),
    ],
)
def test_what_does_not_work_is_one_line_with_a_remedy(environment: dict[str, str], text: str) -> None:
    result = run(SHOW, **environment)
    last = result.stderr.strip().splitlines()[-1]
    assert last.startswith("sarmitsuba.core.errors.BackendError: ") and text in last


def test_the_packages_libcxx_is_loaded_without_its_links(tmp_path: Path) -> None:
    """As after an installation by root, of which no start of the interpreter may make the links."""
    choice = backend._packaged_llvm()
    folders = [] if choice is None else [*choice.path.parent.glob("*-linux-gnu")]
    if not folders:
        pytest.skip("LLVM is not from the package")
    place = tmp_path / folders[0].name
    place.mkdir()
    for name in ("libunwind", "libc++abi", "libc++"):
        shutil.copy(folders[0] / f"{name}.so.1.0", place)
    code = (
        "import ctypes, pathlib; from sarmitsuba.machine.backend import _preload_libcxx as p;"
        f"p(pathlib.Path({str(tmp_path / 'libLLVM.so')!r})); ctypes.CDLL('libc++.so.1');"
        "print([line.split()[-1] for line in open('/proc/self/maps') if 'libc++.so' in line][0])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.stdout.strip() == str(place / "libc++.so.1.0"), done.stderr


LIMITED = """
import resource, sys
resource.setrlimit(resource.{limit}, ({soft}, {soft}))
from sarmitsuba import cli
sys.exit(cli.main(["link", "point"]))
"""


@pytest.mark.skipif(sys.platform == "win32", reason="limits of Unix")
@pytest.mark.parametrize("megabytes", [300, 700, 900])
def test_an_address_space_that_is_too_small_is_refused_in_one_line(megabytes: int) -> None:
    """With 700 MB a run ended by SIGSEGV."""
    code = LIMITED.format(limit="RLIMIT_AS", soft=megabytes * 1_000_000)
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert run.returncode == 2
    assert re.fullmatch(
        rf"error: the address space is limited to {megabytes} MB, of \d+ MB needed; .*\n", run.stderr
    )


@pytest.mark.skipif(sys.platform == "win32", reason="limits of Unix")
def test_too_few_threads_are_refused_in_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    """OpenBLAS interrupts a process that cannot start its threads. Root has no such limit: it is made here."""
    import resource

    started: list[threading.Thread] = []

    def start(thread: threading.Thread) -> None:
        if len(started) == 2:
            raise RuntimeError("can't start new thread")
        started.append(thread)

    monkeypatch.setattr(
        resource, "getrlimit", lambda which: (3, 3) if which == resource.RLIMIT_NPROC else (-1, -1)
    )
    monkeypatch.setattr(threading.Thread, "start", start)
    monkeypatch.setattr(threading.Thread, "join", lambda thread: None)
    with pytest.raises(ResourceError, match=r"2 of \d+ threads can be started: the limit of processes is 3"):
        check_limits()


@pytest.mark.skipif(sys.platform == "win32", reason="a folder in use cannot be deleted there")
def test_a_deleted_working_folder_is_refused_in_one_line(tmp_path: Path) -> None:
    """Mitsuba aborted the process after its line."""
    code = "import os, sys; from sarmitsuba import cli; os.rmdir(os.getcwd()); sys.exit(cli.main(['link', 'point']))"
    environment = os.environ | {"PYTHONPATH": str(Path(__file__).parents[2])}
    (tmp_path / "gone").mkdir()
    run = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, cwd=tmp_path / "gone", env=environment
    )
    assert run.returncode == 2, run.stderr
    assert run.stderr.endswith(
        "error: the working folder is gone (No such file or directory); change to another folder\n"
    )


@pytest.mark.skipif(sys.platform == "win32", reason="limits of Unix")
@pytest.mark.parametrize("most", [6, 12])
def test_too_few_open_files_are_refused_in_one_line(most: int) -> None:
    run = subprocess.run(
        ["sh", "-c", f'ulimit -n {most}; exec "$0" -m sarmitsuba scenes', sys.executable],
        capture_output=True,
        text=True,
        cwd=Path(__file__).parents[2],
    )
    assert (run.returncode, run.stdout) == (2, "")
    assert run.stderr == f"error: {most} files may be open, of 32 needed; raise it (ulimit -n)\n"
