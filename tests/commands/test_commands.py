"""The command line with a stand-in for the simulation: what is written, what is said, how it ends."""

import json
import os
import shlex
import shutil
import signal
import subprocess
import sys
import textwrap
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from sarmitsuba import cli
from sarmitsuba.commands.console import Console
from sarmitsuba.core.errors import BackendError, RadarError, SceneError
from sarmitsuba.version import __version__

LIST = ".sarmitsuba.json"
RESULTS = {
    "accuracy.png",
    "raw.h5",
    "image.h5",
    "image.exr",
    "quicklook.png",
    "quicklook_order.png",
    "parameters.json",
    LIST,
}


def test_render_writes_everything(fake_stages: dict[str, Any], tmp_path: Path, capsys: Any) -> None:
    out = tmp_path / "deep" / "out"
    status = cli.main(
        ["render", "box", "-o", str(out), "-Dh=3", "-D", "w=a=b", "--method", "raw", "--seed", "9"]
    )
    assert status == 0
    assert {p.name for p in out.iterdir()} == RESULTS
    assert fake_stages == {"path": "box", "radar": None, "parameters": {"h": "3", "w": "a=b"}}
    printed = capsys.readouterr()
    # what it takes and does comes first
    assert printed.out.splitlines()[:2] == ["expected: little", "plan: max_depth 2"]
    assert printed.out.splitlines()[-1].startswith(str(out / "quicklook.png"))
    assert printed.err.splitlines() == ["note: a note", "warning: the beam misses a corner"]
    record = json.loads((out / "parameters.json").read_text())
    assert record["seed"] == 9
    assert record["settings"]["method"] == "raw"
    assert record["definitions"] == {"h": "3", "w": "a=b"}
    assert record["warnings"] == ["the beam misses a corner"]
    assert record["notes"] == ["a note"]
    assert record["plan"] == "max_depth 2"
    assert record["radar"]["prf_hz"] == pytest.approx(200.0)  # tol: float rounding
    assert {"load", "simulate", "focus", "write raw", "write image", "picture", "total"} <= set(
        record["seconds"]
    )
    assert record["versions"]["mitsuba"] == "3.9.1"


def test_quiet_says_nothing(fake_stages: dict[str, Any], tmp_path: Path, capsys: Any) -> None:
    assert cli.main(["render", "box", "-o", str(tmp_path), "--quiet"]) == 0
    assert capsys.readouterr() == ("", "")


def test_no_focus_stops_after_raw(fake_stages: dict[str, Any], tmp_path: Path, capsys: Any) -> None:
    assert cli.main(["render", "box", "-o", str(tmp_path), "--no-focus"]) == 0
    assert {p.name for p in tmp_path.iterdir()} == {"raw.h5", "parameters.json", LIST}
    assert str(tmp_path / "raw.h5") in capsys.readouterr().out


def test_focus_of_saved_raw_data_repeats_the_image(fake_stages: dict[str, Any], tmp_path: Path) -> None:
    a, b = tmp_path / "a", tmp_path / "b"
    assert cli.main(["render", "box", "-o", str(a), "--quiet"]) == 0
    assert cli.main(["focus", str(a / "raw.h5"), "-o", str(b), "--quiet"]) == 0
    assert (b / "image.h5").read_bytes() == (a / "image.h5").read_bytes()
    # into the folder the raw data are in: they must survive
    assert cli.main(["focus", str(a / "raw.h5"), "-o", str(a), "--quiet", "--force"]) == 0
    assert (a / "raw.h5").exists()


@pytest.mark.parametrize(
    ("error", "status", "line"),
    [
        (
            SceneError('x.xml: shape "a": mesh b.ply is missing'),
            2,
            'error: x.xml: shape "a": mesh b.ply is missing',
        ),
        (RadarError("two\nlines"), 2, "error: two lines"),
        (BackendError("no LLVM"), 2, "error: no LLVM"),
        (
            MemoryError(),
            2,
            "error: out of memory; choose a smaller image, fewer pulses or a coarser ray_spacing",
        ),
        (KeyboardInterrupt(), 130, "error: interrupted; no half-written file was left behind"),
    ],
)
def test_errors_are_one_line(
    fake_stages: dict[str, Any],
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    capsys: Any,
    error: BaseException,
    status: int,
    line: str,
) -> None:
    def fail(*_: Any, **__: Any) -> None:
        raise error

    monkeypatch.setattr("sarmitsuba.simulation.execution.render.execute", fail)
    out = tmp_path / "out"
    assert cli.main(["render", "box", "-o", str(out)]) == status
    assert capsys.readouterr().err.splitlines()[-1] == line
    assert not out.exists()


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        ([], "arguments are required"),
        (["paint"], "invalid choice"),
        (["render", "box"], "-o/--output"),
        (["render", "box", "-o", "x", "-D", "novalue"], "'novalue' is not of the form NAME=VALUE"),
        (
            ["render", "box", "-o", "x", "-D", "slant_range="],
            "'slant_range=' has no value after the equals sign",
        ),
        (["render", "box", "-o", "x", "--seed", "pi"], "invalid int value"),
    ],
)
def test_wrong_usage_is_one_line(arguments: list[str], text: str, capsys: Any) -> None:
    with pytest.raises(SystemExit) as caught:
        cli.main(arguments)
    assert caught.value.code == 2
    err = capsys.readouterr().err
    assert err.count("\n") == 1 and err.startswith("error: ") and text in err


@pytest.mark.parametrize(
    ("words", "meant"),
    [
        ("rendr tower", "render"),
        ("render tower -o {} --metod raw", "--method"),
        ("picture {} --quantity gama0", "gamma0"),
        ("--extension {}/my_lw.py scenes", "{}/my_law.py"),
        ("--extension sarmitsub scenes", "sarmitsuba"),
        ("validate --case plat", "plate"),
        ("validate --topic orbts", "orbits"),
        ("render point -o {} --focuser omegak", "omega_k"),
        ("render point -o {} --focuser auto,eror=-30", "error"),
        ("render point -o {} --window haming:0.5", "hamming"),
        ("render point -o {} --format hdf", "hdf5"),
    ],
)
def test_what_a_misspelt_name_may_have_meant_is_said(
    words: str, meant: str, tmp_path: Path, capsys: Any
) -> None:
    (tmp_path / "my_law.py").write_text("")
    try:
        status = cli.main(shlex.split(words.format(tmp_path)))
    except SystemExit as ended:
        status = ended.code
    err = capsys.readouterr().err
    assert status == 2 and f'; did you mean "{meant.format(tmp_path)}"?' in err, err


def test_folder_that_cannot_be_written_is_found_before_the_work(
    fake_stages: dict[str, Any], tmp_path: Path, capsys: Any
) -> None:
    file = tmp_path / "file"
    file.write_text("")
    assert cli.main(["render", "box", "-o", str(file)]) == 2
    assert "is a file, not a folder" in capsys.readouterr().err
    assert cli.main(["render", "box", "-o", str(file / "below")]) == 2
    assert "cannot create the folder" in capsys.readouterr().err
    assert fake_stages == {}


def test_focus_of_a_missing_file(tmp_path: Path, capsys: Any) -> None:
    assert cli.main(["focus", str(tmp_path / "raw.h5"), "-o", str(tmp_path / "o")]) == 2
    assert "no such file" in capsys.readouterr().err


def run_in_terminal(code: str) -> str:
    """Output on a pseudo-terminal of a Python program."""
    import pty

    leader, follower = pty.openpty()
    process = subprocess.Popen(
        [sys.executable, "-c", textwrap.dedent(code)], stdout=follower, stderr=follower
    )
    os.close(follower)
    chunks = []
    try:
        while chunk := os.read(leader, 65536):
            chunks.append(chunk)
    except OSError:  # Linux's way to say that the other side is closed
        pass
    os.close(leader)
    assert process.wait() == 0
    return b"".join(chunks).decode()


PROGRESS = """
    import time
    from sarmitsuba.commands.console import Console
    console = Console({options})
    console.expect({{"trace": 1.0, "focus": 1.0}})
    for i in range(4):
        console.progress("trace", i + 1, 4, {{"rays/s": 4.1e6}})
        time.sleep(0.25)
    console.progress("focus", 1, 2, {{}})
    console.warn("three quarters")
    console.end_progress()
"""


@pytest.mark.skipif(sys.platform == "win32", reason="no pseudo-terminal")
def test_progress_shows_rate_and_time_left_on_a_terminal() -> None:
    shown = run_in_terminal(PROGRESS.format(options=""))
    assert "4.10M rays/s" in shown
    assert "left" in shown
    assert "trace" in shown and "focus" in shown
    # one bar for both stages
    assert "50%" in shown and "75%" in shown and "100%" not in shown
    assert "warning: three quarters" in shown
    assert run_in_terminal(PROGRESS.format(options="quiet=True")) == ""


def test_progress_off_a_terminal_is_a_line_every_tenth_of_the_whole_run(capsys: Any) -> None:
    """Ten steps of tracing that last 3 s each, then ten of focusing of 1 s: expected to last as long as each other."""
    now = 0.0
    console = Console(clock=lambda: now)
    console.expect({"trace": 40.0, "focus": 40.0})
    for stage, seconds in (("trace", 3.0), ("focus", 1.0)):
        for step in range(20):
            now += 0.5 * seconds
            console.progress(stage, step + 1, 20, {"rays/s": 4.1e6} if stage == "trace" else {})
    lines = capsys.readouterr().err.splitlines()
    assert [int(line.split()[0]) for line in lines] == list(range(10, 101, 10))
    assert lines[0] == " 10 % trace: 0:06 so far, 0:54 left, 4.10M rays/s"
    assert lines[4] == " 50 % trace: 0:30 so far, 0:30 left, 4.10M rays/s"
    assert lines[-1] == "100 % focus: 0:40 so far, 0:00 left"
    console.expect({"cost": 40.0}, at_most=True)
    now += 10.0
    console.progress("cost", 10.0, 40.0, {})
    assert capsys.readouterr().err.splitlines() == [" 20 % cost: 0:10 so far, at most 0:30 left"]


def test_a_run_of_a_second_shows_no_progress_off_a_terminal(capsys: Any) -> None:
    now = 0.0
    console = Console(clock=lambda: now)
    for step in range(10):
        now += 0.1
        console.progress("trace", step + 1, 10, {})
    assert capsys.readouterr() == ("", "")


@pytest.mark.skipif(sys.platform == "win32", reason="signals")
def test_interrupt_leaves_no_half_written_file(tmp_path: Path) -> None:
    # the stand-in for the simulation waits, so that the signal comes in the middle of the work
    code = f"""
        import signal, sys, time
        # a test run in the background is started with the signal ignored
        signal.signal(signal.SIGINT, signal.default_int_handler)
        sys.path.insert(0, {str(Path(__file__).parent)!r})
        import pytest, conftest as t
        from sarmitsuba import cli
        t.install_fakes(pytest.MonkeyPatch())
        def wait(*a, **k):
            print("working", flush=True)
            time.sleep(30)
        import sarmitsuba.simulation.execution.render as renders
        renders.execute = wait
        sys.exit(cli.main(["render", "box", "-o", {str(tmp_path / "out")!r}]))
    """
    process = subprocess.Popen(
        [sys.executable, "-c", textwrap.dedent(code)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    with process:
        assert process.stdout is not None
        assert process.stdout.readline() == "working\n"
        process.send_signal(signal.SIGINT)
        try:
            _, err = process.communicate()
        finally:
            process.kill()
    assert process.returncode == 130
    assert "Traceback" not in err
    assert list(tmp_path.iterdir()) == []


SCENE = """<scene version="3.0.0">
  <shape type="ply"><string name="filename" value="meshes/a.ply"/></shape>
  <include filename="part.xml"/>
</scene>
"""
PART = """<scene version="3.0.0">
  <sensor type="sar_antenna"><string name="track_file" value="track.csv"/></sensor>
</scene>
"""


def test_scene_is_copied_with_everything_it_needs(tmp_path: Path, capsys: Any) -> None:
    source, target = tmp_path / "source", tmp_path / "target"
    (source / "meshes").mkdir(parents=True)
    for name, text in (
        ("s.xml", SCENE),
        ("part.xml", PART),
        ("meshes/a.ply", "ply"),
        ("track.csv", "0,0,0,0"),
    ):
        (source / name).write_text(text)
    arguments = ["scenes", "--copy", str(source / "s.xml"), str(target)]
    assert cli.main(arguments) == 0
    copied = {p.relative_to(target).as_posix() for p in target.rglob("*") if p.is_file()}
    assert copied == {"s.xml", "part.xml", "meshes/a.ply", "track.csv"}
    capsys.readouterr()
    assert cli.main(arguments) == 2
    assert "exists; choose another folder" in capsys.readouterr().err
    shutil.rmtree(target)
    (source / "track.csv").unlink()
    assert cli.main(arguments) == 2
    assert "track.csv, which does not exist" in capsys.readouterr().err
    assert not target.exists()


def test_shipped_scenes_are_listed(capsys: Any) -> None:
    assert cli.main(["scenes"]) == 0
    assert capsys.readouterr().out.startswith("scenes:\n")


Runner = Callable[..., subprocess.CompletedProcess[str]]


@pytest.fixture
def run() -> Runner:
    def call(*arguments: str, **environment: str) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            [sys.executable, "-m", "sarmitsuba", *arguments],
            capture_output=True,
            text=True,
            env={**os.environ, **environment},
        )

    return call


def test_module_and_version(run: Runner) -> None:
    result = run("--version")
    assert (result.returncode, result.stdout) == (0, f"sarmitsuba {__version__}\n")


def test_doctor_reports_this_machine(run: Runner) -> None:
    result = run("doctor", "--json")
    record = json.loads(result.stdout)
    checks = {check["name"]: check for check in record["checks"]}
    assert {"Python", "mitsuba", "drjit", "back end", "threads", "GPU", "ray rate", "scenes"} <= set(checks)
    assert record["ray_rate_per_s"] > 1e5
    assert result.returncode == (0 if record["ok"] else 1)
    assert result.stderr == ""


def test_doctor_says_what_is_missing(run: Runner, tmp_path: Path) -> None:
    result = run("doctor", DRJIT_LIBLLVM_PATH=str(tmp_path / "none.so"), SARMITSUBA_VARIANT="llvm_ad_rgb")
    assert result.returncode == 1
    assert "MISSING" in result.stdout
    assert "none.so: Dr.Jit cannot use this LLVM library; unset it, or pip install" in result.stdout
    assert "Traceback" not in result.stderr


def test_the_help_of_every_command_imports_no_library() -> None:
    """Numbers, files and pictures are imported when a command runs: help answers at once."""
    script = (
        "import sys\n"
        "from sarmitsuba.cli import build_parser\n"
        "build_parser().format_help()\n"
        "print(sorted({'numpy', 'scipy', 'h5py', 'matplotlib', 'mitsuba', 'trimesh'} & set(sys.modules)))\n"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_values_that_start_with_a_minus_sign_are_told_how_to_be_given(
    capsys: pytest.CaptureFixture[str],
) -> None:
    with pytest.raises(SystemExit):
        cli.main(["rcs", "trihedral", "--azimuth", "-30:30:1"])
    assert "a value that starts with a minus sign needs --azimuth=VALUE" in capsys.readouterr().err
