"""Build a release, install it as a user would, and try it there.

    python tools/release.py             rehearsal: the checkout stays as it is
    python tools/release.py --cut       the same, and once all has passed the changelog and CITATION.cff say so
    ... --site FOLDER                   pack the documentation site that stands there, too

Takes the last commit, not the files of the checkout. In a copy of it the changelog's section of what is unreleased
becomes that of the version in ``sarmitsuba/version.py``, the only place of the version; wheel and source package are
built from that copy into ``dist/``, and a lock file: the version and hash of everything that the wheel needs, for this
interpreter and machine (``pip install --require-hashes --no-deps -r LOCK``). Each package is installed by such a lock
into an environment of its own, whose packages are then read-only, and tried in an empty folder without a network:
``doctor``, three shipped scenes, the Python block of the README. The wheel's extra ``all`` must resolve. Beside the
packages goes a page of the version's known limits, from the changelog. Started by root, the trial runs as the user
``nobody`` where that user can start the interpreter.
"""

import argparse
import json
import os
import re
import shutil
import subprocess
import sys
import tarfile
import tempfile
import time
from collections.abc import Sequence
from datetime import date
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
SCENES = ("tower", "car_park", "farm_yard")
NOBODY = 65534
REPOSITORY = "https://github.com/sarmitsuba/sarmitsuba"
# fails where a network can be reached: connecting to a documentation address (RFC 5737) gets no route
NO_NETWORK = """
import socket
with socket.socket() as place:
    place.settimeout(2.0)
    try:
        place.connect(("192.0.2.1", 80))
    except OSError as error:
        if "unreachable" not in str(error) and "no network" not in str(error):
            raise SystemExit(f"the network is not cut: {error}")
"""
# where network namespaces are not allowed: every socket of the internet refuses to connect
BLOCKED = '''"""Refuses connections."""
import socket

class Blocked(socket.socket):
    def connect(self, address):
        raise OSError("no network in this trial")

    connect_ex = sendto = connect

socket.socket = Blocked
'''
IN_SITE = """
import pathlib, sysconfig, sarmitsuba
from sarmitsuba.loading.library import scenes_dir
site = pathlib.Path(sysconfig.get_path("purelib")).resolve()
for place in (pathlib.Path(sarmitsuba.__file__).resolve(), scenes_dir().resolve()):
    assert place.is_relative_to(site), place
try:
    (site / "sarmitsuba" / "probe").write_text("")
except OSError:
    print("installed in", site.parent.name + "/" + site.name + ", read-only")
else:
    raise SystemExit(f"{site} can be written")
"""


class ReleaseError(Exception):
    """What keeps a release from being made."""


def version_of(root: Path) -> str:
    """The version in ``sarmitsuba/version.py``."""
    found = re.search(
        r'^__version__ = "(.+)"$', (root / "sarmitsuba" / "version.py").read_text(), re.MULTILINE
    )
    if found is None:
        raise ReleaseError("sarmitsuba/version.py: no line __version__ = ...")
    return found[1]


def cut_changelog(text: str, version: str, day: str) -> str:
    """The changelog with what is unreleased as the section of a version, below a new empty section.

    Raises
    ------
    ReleaseError
        The section ``## Unreleased: VERSION`` is not there or empty, or the version has been released.
    """
    if re.search(rf"^## {re.escape(version)}\b", text, re.MULTILINE):
        raise ReleaseError(f"CHANGELOG.md: {version} has been released; raise sarmitsuba/version.py")
    heading = f"## Unreleased: {version}\n"
    if text.count(heading) != 1:
        raise ReleaseError(f'CHANGELOG.md: no section "{heading.strip()}"')
    before, after = text.split(heading)
    if not re.match(r"\s*(?!## )\S", after):
        raise ReleaseError(f"CHANGELOG.md: nothing stands under {heading.strip()}")
    return f"{before}## Unreleased\n\n## {version} - {day}\n{after}"


def cut_limits(changelog: str, version: str, home: str) -> str:
    """Page of the known limits of a version, by its section of the cut changelog.

    Parameters
    ----------
    changelog : as :func:`cut_changelog` leaves it
    version : of the section
    home : address that links to files of the repository begin with

    Raises
    ------
    ReleaseError
        The version has no section, or names no limit in it.
    """
    section = re.search(rf"^## {re.escape(version)} - .+?(?=^## |\Z)", changelog, re.MULTILINE | re.DOTALL)
    limits = section and re.search(
        r"^### Known limits\n+(\S.*?)(?=^### |\Z)", section[0], re.MULTILINE | re.DOTALL
    )
    if not limits:
        raise ReleaseError(f'CHANGELOG.md: {version} has no "### Known limits" with an entry')
    text = re.sub(r"\]\((?!https?:)", f"]({home}/blob/v{version}/", limits[1].rstrip())
    return f"# Known limits of sarmitsuba {version}\n\n{text}\n"


def cut_citation(text: str, version: str, day: str) -> str:
    """CITATION.cff with the version and the day of its release."""
    text = re.sub(r"^date-released: .*\n", "", text, flags=re.MULTILINE)
    text, n = re.subn(r"^version: .*$", f"version: {version}\ndate-released: {day}", text, flags=re.MULTILINE)
    if n != 1:
        raise ReleaseError("CITATION.cff: no line version: ...")
    return text


def cut(root: Path, day: str) -> None:
    """Write the release into the changelog and CITATION.cff of a checkout."""
    version = version_of(root)
    for name, change in (("CHANGELOG.md", cut_changelog), ("CITATION.cff", cut_citation)):
        path = root / name
        path.write_text(change(path.read_text(encoding="utf-8"), version, day), encoding="utf-8")


def lock_of(report: dict[str, Any], package: str) -> str:
    """Requirements with versions and hashes of all that pip would install for a package, without the package itself.

    Parameters
    ----------
    report : of ``pip install --dry-run --ignore-installed --report``
    package : its name

    Raises
    ------
    ReleaseError
        Something has no SHA-256 hash.
    """
    lines = []
    for entry in report["install"]:
        name, version = entry["metadata"]["name"], entry["metadata"]["version"]
        if name.lower() == package:
            continue
        archive = entry["download_info"].get("archive_info", {})
        found = archive.get("hashes", {}).get("sha256") or archive.get("hash", "").partition("sha256=")[2]
        if not re.fullmatch(r"[0-9a-f]{64}", found):
            raise ReleaseError(f"{name} {version}: pip reports no SHA-256 hash")
        lines.append(f"{name}=={version} --hash=sha256:{found}\n")
    return "".join(sorted(lines, key=str.lower))


def python_blocks(readme: str) -> list[str]:
    """Python blocks of a page."""
    return re.findall(r"^```python\n(.*?)^```$", readme, re.MULTILINE | re.DOTALL)


def build(copy: Path, target: Path) -> list[Path]:
    """Wheel and source package of a copy of the repository, checked for what must be in them."""
    wanted = {str(path.relative_to(copy)) for path in copy.rglob("*") if path.is_file()}
    words = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-t", "sdist", "-d", str(target)]
    run = subprocess.run(words, cwd=copy, capture_output=True, text=True)
    if run.returncode != 0:
        raise ReleaseError(f"the build ended with {run.returncode}:\n{run.stdout}{run.stderr}")
    version = version_of(copy)
    wheel, source = (
        target / f"sarmitsuba-{version}-py3-none-any.whl",
        target / f"sarmitsuba-{version}.tar.gz",
    )
    with tarfile.open(source) as archive:
        names = {name.partition("/")[2] for name in archive.getnames()}
    missing = sorted(name for name in wanted - names if not name.startswith("."))
    if missing:
        raise ReleaseError(f"{source.name} lacks {', '.join(missing[:5])}")
    return [wheel, source]


class Trial:
    """An environment with one package installed, used by a plain user without a network.

    Parameters
    ----------
    package : wheel or source package
    folder : new folder for the environment
    python : interpreter to make it with
    """

    def __init__(self, package: Path, folder: Path, python: str) -> None:
        self.environment, self.home = folder / "environment", folder / "home"
        self.home.mkdir(parents=True)
        subprocess.run([python, "-m", "venv", str(self.environment)], check=True)
        self.python = str(self.environment / "bin" / "python")
        # elsewhere than in the checkout, whose files must not be found
        pip = [self.python, "-m", "pip", "--disable-pip-version-check", "--quiet", "install"]
        report = folder / "report.json"
        asked = ["--dry-run", "--ignore-installed", "--report", str(report), str(package)]
        subprocess.run([*pip, *asked], check=True, cwd=self.home)
        if package.suffix == ".whl":
            with_extras = ["--dry-run", "--ignore-installed", f"{package}[all]"]
            subprocess.run([*pip, *with_extras], check=True, cwd=self.home)
        self.lock = folder / "lock.txt"
        self.lock.write_text(
            lock_of(json.loads(report.read_text(encoding="utf-8")), "sarmitsuba"), encoding="utf-8"
        )
        by_lock = ["--require-hashes", "--no-deps", "-r", str(self.lock)]
        subprocess.run([*pip, *by_lock], check=True, cwd=self.home)
        subprocess.run([*pip, "--no-deps", str(package)], check=True, cwd=self.home)
        subprocess.run([*pip[:-1], "check"], check=True, cwd=self.home)
        subprocess.run(["chmod", "-R", "a+rX,a-w", str(self.environment)], check=True)
        self.variables = {
            **{"PATH": "/usr/bin:/bin", "HOME": str(self.home), "TMPDIR": str(self.home)},
            "LANG": "C.UTF-8",
        }
        self.prefix, self.how = _plain_user(self.python), []
        self.how.append("as nobody" if self.prefix else "as root" if os.geteuid() == 0 else "as this user")
        if self.prefix:
            os.chown(self.home, NOBODY, NOBODY)
        own = ["unshare", "-n"] if os.geteuid() == 0 else ["unshare", "--map-current-user", "-n"]
        if shutil.which("unshare") and subprocess.run([*own, "true"], capture_output=True).returncode == 0:
            self.prefix = [*own, *self.prefix]
            self.how.append("without a network")
        else:
            block = folder / "block"
            block.mkdir()
            (block / "sitecustomize.py").write_text(BLOCKED, encoding="utf-8")
            self.variables["PYTHONPATH"] = str(block)
            self.how.append("with Python's sockets blocked")

    def tag(self) -> str:
        """Name of the interpreter and the machine, such as ``cp311-linux_x86_64``."""
        words = "import sys, sysconfig; print('cp%d%d' % sys.version_info[:2], sysconfig.get_platform())"
        run = subprocess.run([self.python, "-c", words], check=True, capture_output=True, text=True)
        return run.stdout.strip().replace("-", "_").replace(" ", "-")

    def run(self, *arguments: str) -> str:
        """Output of the environment's interpreter with arguments; raises a ReleaseError where it fails."""
        run = subprocess.run(
            [*self.prefix, self.python, *arguments],
            env=self.variables,
            cwd=self.home,
            capture_output=True,
            text=True,
        )
        if run.returncode != 0:
            shown = " ".join(arguments) if arguments[0] == "-m" else "a block of Python"
            raise ReleaseError(f"{shown} ended with {run.returncode}:\n{run.stdout}{run.stderr}")
        return run.stdout

    def all(self, version: str, blocks: Sequence[str]) -> None:
        """Everything that a release is tried by."""
        print(f"  {', '.join(self.how)}")
        self.run("-c", NO_NETWORK)
        print(f"  {self.run('-c', IN_SITE).strip()}")
        said = self.run("-m", "sarmitsuba", "--version").strip()
        if said != f"sarmitsuba {version}":
            raise ReleaseError(f"--version says {said}, not {version}")
        print(f"  {said}")
        print("".join(f"  {line}\n" for line in self.run("-m", "sarmitsuba", "doctor").splitlines()), end="")
        for scene in SCENES:
            start = time.monotonic()
            self.run("-m", "sarmitsuba", "render", scene, "-o", f"out/{scene}", "--quiet")
            files = sorted(path.name for path in (self.home / "out" / scene).iterdir())
            for name in ("image.h5", "quicklook.png", "parameters.json"):
                if name not in files:
                    raise ReleaseError(f"render {scene} wrote no {name}")
            print(f"  render {scene}: {', '.join(files)} in {time.monotonic() - start:.0f} s")
        for block in blocks:
            self.run("-c", block)
        print(f"  README: {len(blocks)} block of Python run")


def _plain_user(python: str) -> list[str]:
    """Words before a command that make it run as nobody; none where it is a plain user's already, or cannot be."""
    if os.geteuid() != 0 or not shutil.which("setpriv"):
        return []
    words = ["setpriv", f"--reuid={NOBODY}", f"--regid={NOBODY}", "--clear-groups"]
    return words if subprocess.run([*words, python, "-V"], capture_output=True).returncode == 0 else []


def release(python: str, target: Path, day: str) -> None:
    """Build from the last commit, install, try."""
    with tempfile.TemporaryDirectory(prefix="release-") as name:
        folder = Path(name)
        folder.chmod(0o755)
        copy = folder / "source"
        copy.mkdir()
        git = ["git", "-C", str(ROOT)]
        archive = subprocess.run([*git, "archive", "HEAD"], capture_output=True, check=True).stdout
        subprocess.run(["tar", "-x", "-C", str(copy)], input=archive, check=True)
        commit = subprocess.run(
            [*git, "log", "-1", "--format=%h %ct"], capture_output=True, text=True, check=True
        )
        short, seconds = commit.stdout.split()
        os.environ["SOURCE_DATE_EPOCH"] = seconds  # the same commit gives the same files
        version = version_of(copy)
        print(f"sarmitsuba {version} of commit {short}")
        cut(copy, day)
        blocks = python_blocks((copy / "README.md").read_text(encoding="utf-8"))
        if not blocks:
            raise ReleaseError("README.md has no block of Python")
        target.mkdir(exist_ok=True)
        limits = target / f"sarmitsuba-{version}-limits.md"
        changes = (copy / "CHANGELOG.md").read_text(encoding="utf-8")
        limits.write_text(cut_limits(changes, version, REPOSITORY), encoding="utf-8")
        print(limits.name)
        for package in build(copy, target):
            print(f"{package.name}, {package.stat().st_size / 1e6:.1f} MB")
            trial = folder / package.name
            trial.mkdir()
            try:
                tried = Trial(package, trial, python)
                tried.all(version, blocks)
                if package.suffix == ".whl":
                    lock = target / f"sarmitsuba-{version}-{tried.tag()}.lock"
                    shutil.copy(tried.lock, lock)
                    print(f"  {lock.name}: {len(lock.read_text().splitlines())} packages with their hashes")
            finally:
                subprocess.run(["chmod", "-R", "u+w", str(trial)], check=True)


def pack_site(site: Path, target: Path, version: str) -> Path:
    """Archive of the documentation site; raises a ReleaseError where none has been built."""
    if not (site / "index.html").is_file():
        raise ReleaseError(f"{site} holds no site; make docs builds it")
    name = f"sarmitsuba-{version}-site"
    with tarfile.open(target / f"{name}.tar.gz", "w:gz") as archive:
        archive.add(site, name)
    return target / f"{name}.tar.gz"


def main() -> int:
    """Parse the command line and make the release."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument(
        "--cut", action="store_true", help="write the release into CHANGELOG.md and CITATION.cff"
    )
    parser.add_argument("--site", type=Path, help="folder of the built documentation site, packed into dist")
    parser.add_argument("--python", default=sys.executable, help="interpreter of the trial environments")
    args = parser.parse_args()
    day = date.today().isoformat()
    try:
        release(args.python, ROOT / "dist", day)
        if args.site:
            print(pack_site(args.site, ROOT / "dist", version_of(ROOT)).name)
        if args.cut:
            cut(ROOT, day)
    except ReleaseError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    except subprocess.CalledProcessError as error:
        print(
            f"error: {' '.join(map(str, error.cmd[:4]))} ... ended with {error.returncode}", file=sys.stderr
        )
        return 1
    version = version_of(ROOT)
    print(
        f"commit the changelog, then: git tag v{version}"
        if args.cut
        else "rehearsed; make release CUT=1 writes it down"
    )
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
