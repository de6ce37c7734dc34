"""A headless browser, and bare pages that run the page's own modules on given data."""

import base64
import json
import shutil
import subprocess
from collections.abc import Callable, Generator, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import sarmitsuba.view.page

WEB = Path(sarmitsuba.view.page.__file__).parent / "web"
BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome")
FLAGS = (
    "--headless=new",
    "--no-sandbox",
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
)


def browser() -> str | None:
    """The first browser on the path."""
    return next(filter(None, map(shutil.which, BROWSERS)), None)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item: pytest.Item) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    """Say once why all tests that need the browser, or Node.js, are skipped, not once a test."""
    report = yield
    if report.skipped and {"chromium", "in_node"} & set(getattr(item, "fixturenames", ())):
        assert isinstance(report.longrepr, tuple)
        report.longrepr = (__file__, None, report.longrepr[2])  # equal places and reasons are folded
    return report


@contextmanager
def browsing(path: str, folder: Path) -> Iterator[Any]:
    """A browser context without network and with WebGL in software; ``folder`` is its empty profile."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        context = playwright.chromium.launch_persistent_context(
            str(folder),
            executable_path=path,
            args=list(FLAGS),
            offline=True,
            viewport={"width": 1280, "height": 800},
        )
        yield context
        context.close()


@pytest.fixture(scope="session")
def chromium(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    """A browser context without network and with WebGL in software."""
    pytest.importorskip("playwright.sync_api", reason="drives the browser; in the test extra")
    path = browser()
    if path is None:
        pytest.skip(f"no browser: none of {', '.join(BROWSERS)} is on the path")
    with browsing(path, tmp_path_factory.mktemp("browser")) as context:
        yield context


# marks a page whose script could not be read or ended with an error before it was ready
WATCH = """for (const kind of ["error", "unhandledrejection"]) {
  addEventListener(kind, () => { document.documentElement.dataset.failed = "true"; });
}"""


@dataclass
class Open:
    """A page in the browser, what it complained of and the addresses that it asked for."""

    page: Any
    complaints: list[str] = field(default_factory=list)
    requests: list[str] = field(default_factory=list)

    def call(self, script: str, **values: Any) -> Any:
        """Value of the body of an async function; ``page`` is the page's own object."""
        names = ", ".join(values)
        text = f"async ({{{names}}}) => {{ const {{ page }} = window.sarmitsuba; {script} }}"
        return self.page.evaluate(text, values)

    def resize(self, width: int, height: int) -> None:
        """Give the window another size, and wait until the page stands in it: its canvases follow a frame later."""
        self.page.set_viewport_size({"width": width, "height": height})
        self.page.wait_for_function("([w, h]) => innerWidth === w && innerHeight === h", arg=[width, height])
        self.idle()

    def idle(self) -> None:
        """Wait until what was asked for is drawn."""
        self.call(
            "for (let i = 0; i < 3; i++) await new Promise((resolve) => requestAnimationFrame(resolve));"
        )


@pytest.fixture(scope="module")
def opened(chromium: Any) -> Iterator[Callable[..., Open]]:
    """Open a page's file and wait until it is ready; a page that cannot start fails at once.

    In a window of so many picture elements (width, height): WebGL in software draws every one.
    """
    pages: list[Open] = []

    def call(path: Path, window: tuple[int, int] = (1280, 800)) -> Open:
        page = chromium.new_page()
        page.set_viewport_size(dict(zip(("width", "height"), window, strict=True)))
        page.set_default_timeout(600_000)  # a stop for what hangs, not a verdict: machines may be busy
        page.add_init_script(WATCH)
        one = Open(page)
        pages.append(one)
        page.on(
            "console", lambda m: one.complaints.append(m.text) if m.type in ("error", "warning") else None
        )
        page.on("pageerror", lambda error: one.complaints.append(str(error)))
        page.on("request", lambda request: one.requests.append(request.url))
        page.goto(path.as_uri())
        page.wait_for_selector("html[data-ready], html[data-failed]")
        assert page.get_attribute("html", "data-failed") is None, one.complaints
        return one

    yield call
    for one in pages:
        one.page.close()


def encode(arrays: dict[str, Any]) -> dict[str, Any]:
    return {
        name: {"kind": array.dtype.str[1:], "base64": base64.b64encode(np.ascontiguousarray(array)).decode()}
        for name, array in arrays.items()
    }


DECODE = """
const KINDS = { f8: Float64Array, f4: Float32Array, i2: Int16Array };
window.unpack = (header, arrays) => {
  const out = structuredClone(header);
  for (const [name, { kind, base64 }] of Object.entries(arrays)) {
    const value = new KINDS[kind](Uint8Array.from(atob(base64), (c) => c.charCodeAt(0)).buffer);
    const [first, rest] = name.split(".");
    if (rest) out[first][rest] = value; else out[first] = value;
  }
  return out;
};
window.pack = (array) => {
  const bytes = new Uint8Array(array.buffer, array.byteOffset, array.byteLength);
  let text = "";
  for (let i = 0; i < bytes.length; i += 8192) text += String.fromCharCode(...bytes.subarray(i, i + 8192));
  return btoa(text);
};
"""


class Bench:
    """An open page with our modules in its import map, and what it logged."""

    def __init__(self, page: Any, folder: Path) -> None:
        self.page, self.errors = page, []
        page.on("console", lambda m: self.errors.append(m.text) if m.type in ("error", "warning") else None)
        page.on("pageerror", lambda error: self.errors.append(str(error)))
        modules = {
            f"sarmitsuba/{path.name}": "data:text/javascript;base64,"
            + base64.b64encode(path.read_bytes()).decode()
            for path in WEB.glob("*.js")
        }
        file = folder / "bench.html"
        file.write_text(
            "<!doctype html><html lang='en'><meta charset='utf-8'><title>bench</title>"
            f"<script type='importmap'>{json.dumps({'imports': modules})}</script>"
            f"<script>{DECODE}</script><body><div id='stage'></div></body></html>",
            encoding="utf-8",
        )
        page.goto(file.as_uri())

    def run(self, script: str, **values: Any) -> Any:
        """Value of the body of an async function; ``values`` are its arguments by name, pairs (header, arrays) too."""
        plain = {}
        for name, value in values.items():
            whole = isinstance(value, tuple)
            plain[name] = [value[0], encode(value[1])] if whole else value
        wrapped = [name for name, value in values.items() if isinstance(value, tuple)]
        opened = "".join(f"{name} = unpack(...{name});" for name in wrapped)
        names = ", ".join(values)
        return self.page.evaluate(f"async ({{{names}}}) => {{ {opened} {script} }}", plain)


@pytest.fixture
def bench(chromium: Any, tmp_path: Path) -> Iterator[Bench]:
    """A bare page; the test fails when it logs an error or a warning."""
    page = chromium.new_page()
    one = Bench(page, tmp_path)
    yield one
    page.close()
    assert one.errors == []


@pytest.fixture
def floats() -> Callable[[str, tuple[int, ...]], Any]:
    """Read a float32 array that the page packed."""

    def read(text: str, shape: tuple[int, ...]) -> Any:
        return np.frombuffer(base64.b64decode(text), dtype=np.float32).reshape(shape)

    return read


# values come as JSON, which has neither typed arrays nor infinities
IN_NODE = """
import {{ readFileSync }} from "node:fs";
const {{ {names} }} = JSON.parse(readFileSync(0, "utf8"));
const value = await (async () => {{ {script} }})();
process.stdout.write(JSON.stringify({{ value }}, (_, x) =>
  ArrayBuffer.isView(x) ? Array.from(x) : typeof x === "number" && !Number.isFinite(x) ? String(x) : x));
"""
NODE_LEAST = 18


@pytest.fixture(scope="session")
def in_node(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., Any]:
    """Value of the body of an async function in Node.js, without a document; keywords are its arguments by name.

    Numbers that are not finite come back as texts.
    """
    program = shutil.which("node")
    if program is None:
        pytest.skip("no node on the path")
    version = subprocess.run([program, "--version"], capture_output=True, text=True, check=True).stdout
    if int(version.lstrip("v").split(".")[0]) < NODE_LEAST:
        pytest.skip(f"node {version.strip()} is older than {NODE_LEAST}")
    folder = tmp_path_factory.mktemp("node")
    package = folder / "node_modules" / "sarmitsuba"
    shutil.copytree(WEB, package, ignore=shutil.ignore_patterns("vendor"))
    (package / "package.json").write_text('{"type": "module"}', encoding="utf-8")

    def call(script: str, **values: Any) -> Any:
        text = IN_NODE.format(names=", ".join(values), script=script)
        run = subprocess.run(
            [program, "--input-type=module", "-e", text],
            input=json.dumps(values, allow_nan=False),
            capture_output=True,
            text=True,
            encoding="utf-8",
            cwd=folder,
        )
        assert run.returncode == 0, run.stderr
        return json.loads(run.stdout).get("value")

    return call
