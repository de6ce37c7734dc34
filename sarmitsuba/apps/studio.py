"""Web page of the studio: sliders beside a 3-D view of the scene, with viser.

Controls only signal a change. The thread in :meth:`Studio.serve` simulates and differentiates, always the newest
state, so that a dragged slider never waits for outdated states. The derivative of the image by one parameter shows the
change as, for example, a wall moves. Access is limited to this machine, this page and the secret address.
"""

import dataclasses
import hmac
import http
import secrets
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, redirect_stdout
from dataclasses import replace
from io import StringIO
from pathlib import Path
from urllib.parse import parse_qs, urlsplit

import numpy as np
import viser
import websockets.asyncio.server
from scipy.spatial.transform import Rotation
from websockets.datastructures import Headers
from websockets.http11 import Request, Response

from sarmitsuba.apps.fit.changed_view import IMAGE, PICTURES, ChangedView
from sarmitsuba.apps.fit.image_derivative import image_derivative
from sarmitsuba.apps.fit.parsing import list_parameters
from sarmitsuba.apps.studio_bench import View, command, first_state, save, surfaces, view_of
from sarmitsuba.apps.studio_scene import beam_at, bodies, image_plane, track_shown
from sarmitsuba.core.arrays import F32, F64, U8
from sarmitsuba.core.constants import BANDS
from sarmitsuba.core.errors import SarmitsubaError
from sarmitsuba.core.timing import Clock
from sarmitsuba.radar.mode import MODES
from sarmitsuba.radar.polarisation import CHANNELS
from sarmitsuba.scene.materials.named_materials import MATERIALS
from sarmitsuba.scene.scene import Scene
from sarmitsuba.signal.image import SarImage
from sarmitsuba.view.display import Display, PictureOptions, prepare
from sarmitsuba.view.quicklook import panel, pixels

LOOPBACK = ("127.0.0.1", "localhost", "::1")
_COOKIE = "sarmitsuba_studio"

Answer = Callable[[object, Request], Response | None]


class Guard:
    """Check of every request, also of web sockets, before the page's server.

    A request must address a loopback host (other names may be an attacker's names of this machine), originate from a
    page of that host or from none, and contain the secret: first in the address, afterwards in a cookie that is not
    sent to other sites.

    Attributes
    ----------
    token : the secret, new at every start
    """

    def __init__(self) -> None:
        self.token = secrets.token_urlsafe(24)

    def refusal(self, request: Request) -> str:
        """Reason for refusing a request; empty where it is accepted."""
        host = request.headers.get("Host", "")
        origin = request.headers.get("Origin")
        try:
            asked, page = urlsplit(f"//{host}").hostname, None if origin is None else urlsplit(origin).netloc
        except ValueError:  # not an address
            return "this host is not served"
        if asked not in LOOPBACK:
            return "this host is not served"
        if page not in (None, host):
            return "requests from other pages are refused"
        if not (self._in_address(request) or self._in_cookie(request)):
            return "open the address printed by the command"
        return ""

    def around(self, answer: Answer | None) -> Answer:
        """The server's answer, for accepted requests only."""

        def guarded(connection: object, request: Request) -> Response | None:
            reason = self.refusal(request)
            if reason:
                body = f"{reason}\n".encode()
                head = Headers({"Content-Type": "text/plain", "Content-Length": str(len(body))})
                return Response(http.HTTPStatus.FORBIDDEN, "Forbidden", head, body)
            response = None if answer is None else answer(connection, request)
            if response is not None and self._in_address(request):
                response.headers["Set-Cookie"] = f"{_COOKIE}={self.token}; Path=/; HttpOnly; SameSite=Strict"
            return response

        return guarded

    @contextmanager
    def install(self) -> Iterator[None]:
        """Guard web socket servers started within the context; viser has no setting for it."""
        module = websockets.asyncio.server
        plain = module.serve

        def serve(*args: object, process_request: Answer | None = None, **kwargs: object) -> object:
            return plain(*args, process_request=self.around(process_request), **kwargs)  # type: ignore[arg-type]

        module.serve = serve  # type: ignore[misc,assignment]
        try:
            yield
        finally:
            module.serve = plain  # type: ignore[misc]

    def _in_address(self, request: Request) -> bool:
        given = parse_qs(urlsplit(request.path).query).get("token", [""])[0]
        return hmac.compare_digest(given.encode(), self.token.encode())

    def _in_cookie(self, request: Request) -> bool:
        parts = (
            part.strip().partition("=")
            for line in request.headers.get_all("Cookie")
            for part in line.split(";")
        )
        return any(
            name == _COOKIE and hmac.compare_digest(value.encode(), self.token.encode())
            for name, _, value in parts
        )


def check_host(host: str) -> None:
    """Raise a SarmitsubaError for an address that other machines can reach."""
    if host not in LOOPBACK:
        raise SarmitsubaError(
            f"studio: --host {host} can be reached by other machines; choose one of {', '.join(LOOPBACK)}, and from "
            "elsewhere use `ssh -L 8080:127.0.0.1:8080`"
        )


NOTHING = "nothing"

Draw = Callable[[SarImage, PictureOptions, str], None]


class SupersededError(Exception):
    """The derivative that is computed is no longer asked for."""


class DerivativeTab:
    """Choice of a parameter, slider over its change, choice of a picture, and a button that simulates the change.

    Parameters
    ----------
    gui : of the server, with the tab's container open
    draw : shows an image with options and a label; called by :meth:`update`
    wake : called by the controls, from threads of the page
    newer : whether the scene is to be simulated anew, which ends a derivative under way

    Attributes
    ----------
    parameter, change, which, simulate : controls
    status : line below them
    changed : the view that is shown; None: that of the scene as it is
    """

    def __init__(
        self,
        gui: viser.GuiApi,
        draw: Draw,
        wake: Callable[[], None],
        newer: Callable[[], bool],
        *,
        clock: Clock = time.perf_counter,
    ) -> None:
        self._draw, self._newer, self._clock = draw, newer, clock
        self.parameter = gui.add_dropdown(
            "what changes", (NOTHING,), initial_value=NOTHING, hint="differentiates the image by it"
        )
        self.change = gui.add_slider("by", -1.0, 1.0, 0.01, 0.0, disabled=True, hint="nothing is simulated")
        self.which = gui.add_dropdown("picture", PICTURES, initial_value=IMAGE)
        self.simulate = gui.add_button(
            "simulate this change", disabled=True, hint="with the same rays and speckle"
        )
        self.status = gui.add_markdown("")
        self.changed: ChangedView | None = None
        self._offered: View | None = None
        self._of: tuple[View, str] | None = None  # view and parameter of the derivative, or of its refusal
        self._simulation_asked, self._seconds = False, 0.0
        for control in (self.parameter, self.change, self.which):
            control.on_update(lambda _: wake())
        self.simulate.on_click(lambda _: self._ask(wake))

    def _ask(self, wake: Callable[[], None]) -> None:
        self._simulation_asked = True
        wake()

    def update(self, view: View) -> None:
        """Compute and show the requested derivative of the last simulated view."""
        if self._offered is not view:
            self._offered, words = view, (NOTHING, *list_parameters(view.scene))
            if words != tuple(self.parameter.options):
                self.parameter.options = words
        word = self.parameter.value
        if self._of != (view, word):
            if word == NOTHING:
                self._leave(view)
                return
            if not self._differentiate(view, word):
                return
        if self.changed is None:
            return
        if self._simulation_asked:
            self._simulation_asked = False
            self.status.content = "*simulating the change ...*"
            try:
                self.changed = self.changed.with_simulation()
            except SarmitsubaError as error:
                self.status.content = f"**not simulated:** {' '.join(str(error).split())}"
                return
        elif self.changed.at(self.change.value).change != self.changed.change:
            self.changed = self.changed.at(self.change.value)
        which = self.which.value
        self._draw(*self.changed.picture(which), which)
        first, *rest = self.changed.lines()
        self.status.content = "  \n".join([f"**{first}**", *rest, f"derivative in {self._seconds:.1f} s"])

    def _leave(self, view: View) -> None:
        """Return to the image of the scene as it is."""
        shown, self.changed, self._of = self._of, None, (view, NOTHING)
        self.change.disabled = self.simulate.disabled = True
        self.status.content = ""
        if shown is not None and shown[1] != NOTHING:
            self._draw(view.image, PictureOptions(), IMAGE)

    def _differentiate(self, view: View, word: str) -> bool:
        """Compute the derivative of a view's image; False: refused, or no longer asked for."""
        start = self._clock()
        self.changed, self._simulation_asked = None, False
        self.change.disabled = self.simulate.disabled = True
        self.status.content = "*differentiating ...*"

        def go_on(share: float) -> None:
            if self._newer() or self.parameter.value != word:
                raise SupersededError
            self.status.content = f"*differentiating ... {100.0 * share:.0f} %*"

        try:
            found = image_derivative(_use_raw_method(view.scene), word, leave_out=True, progress=go_on)
        except SupersededError:
            self.status.content, self._of = "", None
            return False
        except SarmitsubaError as error:
            self._of = (view, word)
            self.status.content = f"**no derivative:** {' '.join(str(error).split())}"
            return False
        self._of = (view, word)
        self.changed = ChangedView.of(found)
        self._seconds = self._clock() - start
        slider = self.changed.slider
        self.change.label = f"by ({slider.unit})"
        self.change.min, self.change.max, self.change.step = slider.low, slider.high, slider.step
        self.change.value = 0.0
        self.change.disabled = self.simulate.disabled = not found.changes
        return True


def _use_raw_method(scene: Scene) -> Scene:
    """The scene with the method ``hybrid``, unless its method makes raw data."""
    settings = scene.settings
    return (
        scene
        if settings.method in ("raw", "hybrid")
        else replace(scene, settings=replace(settings, method="hybrid"))
    )


AS_IT_IS = "as in the file"
AUTOMATIC = "automatic"
# share of the contrast that an image keeps while a newer one is simulated
_STALE = 0.35
_LARGEST = 2048  # pixels of the longer side of the displayed image
_SIZE = 10.0  # displayed size of every scene, in the clipping range of the browser's camera
_BEAM, _TRACK = (40, 110, 220), (20, 60, 140)


class Studio:
    """Web server of the studio.

    Parameters
    ----------
    source : scene file or name of a shipped scene
    folder : for saved scenes
    host, port : address of the page; a loopback address

    Attributes
    ----------
    state : of the sliders
    view : last simulated view; None before the first
    saved : last saved file
    controls : sliders and boxes by the field of the state; those of surfaces as ``material NAME``
    derivative : controls of the derivative of the image
    """

    def __init__(self, source: str, folder: Path, host: str = "127.0.0.1", port: int = 8080) -> None:
        check_host(host)
        self.state = first_state(source)
        self.folder = folder
        self._work = tempfile.TemporaryDirectory(prefix="sarmitsuba_studio_")
        self.view: View | None = None
        self._stale = False  # whether the image is that of sliders before
        self.saved: Path | None = None
        self.controls: dict[str, viser.GuiInputHandle] = {}
        self._changed, self._woken = threading.Event(), threading.Event()
        self._changed.set()
        self._woken.set()
        self._lock = threading.Lock()
        self._guard = Guard()
        with _suppress_banner(), self._guard.install():
            self.server = viser.ViserServer(host=host, port=port, label="sarmitsuba studio", verbose=False)
        self.server.scene.set_up_direction("+z")
        # no share button: it would publish the page through an external server
        self.server.gui.configure_theme(control_width="large", show_share_button=False)
        self.server.gui.main_panel.dock_right()
        self._build()

    @property
    def address(self) -> str:
        """Address of the page, with the secret."""
        host = self.server.get_host()
        return f"http://{f'[{host}]' if ':' in host else host}:{self.server.get_port()}/?token={self._guard.token}"

    def serve(self, stop: Callable[[], bool] = lambda: False, patience: float = 0.5) -> None:
        """Simulate whenever a slider has moved, until ``stop`` returns True.

        Parameters
        ----------
        stop : called after every simulation, and every ``patience`` seconds without a change
        """
        while not stop():
            if not self._woken.wait(patience):
                continue
            self._woken.clear()
            if self._changed.is_set():
                self.step()
            if self.view is not None and not self._stale:
                self.derivative.update(self.view)

    def step(self) -> None:
        """Simulate the present state of the sliders, and show it."""
        self._changed.clear()
        state = self.state
        self._status.content = "*simulating ...*"
        if self.view is not None and not self._stale:
            self._picture.image = dim_picture(self._picture.image)
            self._stale = True
        try:
            view = view_of(state, Path(self._work.name))
            self._show(view)
        except SarmitsubaError as error:
            # the image stays dim: it is not that of the sliders
            self._status.content = f"**not simulated:** {' '.join(str(error).split())}"
            return
        self._status.content = (
            f"{view.image.grid.shape[0]} x {view.image.grid.shape[1]} pixels by method {state.method} in "
            f"{view.seconds:.1f} s"
        )

    def close(self) -> None:
        """Stop serving the page."""
        with _suppress_banner():
            self.server.stop()
        self._work.cleanup()

    def discard(self) -> None:
        """Remove temporary files, without stopping the server."""
        self._work.cleanup()

    # ------------------------------------------------------------ controls

    def _build(self) -> None:
        gui, state = self.server.gui, self.state
        self._status = gui.add_markdown("*simulating ...*")
        self._picture = gui.add_image(np.full((8, 8, 3), 255, dtype=np.uint8), label=IMAGE)
        self._rcs = gui.add_markdown("")
        # one short page of controls at a time, so that the image above stays in sight
        pages = gui.add_tab_group()
        with pages.add_tab("radar"):
            self._slider("look angle (deg)", "look_angle_deg", 10.0, 75.0, 1.0, "from nadir")
            self._slider(
                "heading (deg)", "heading_deg", -180.0, 180.0, 1.0, "of flight, clockwise from north (+y)"
            )
            self._choice("look side", "look_side", ("right", "left"))
            self._choice("mode", "mode", MODES.names)
            own = f"{state.frequency / 1e9:.4g} GHz"
            bands = {own: state.frequency, **{f"{k}, {v / 1e9:g} GHz": v for k, v in BANDS.items()}}
            band = gui.add_dropdown("band", tuple(bands), initial_value=own)
            band.on_update(lambda _: self._set(frequency=bands[band.value]))
            self.controls["frequency"] = band
            self._slider(
                "resolution (m)",
                "resolution",
                _short(0.5 * state.resolution),
                _short(4.0 * state.resolution),
                _short(0.05 * state.resolution),
                "cell in slant range and azimuth",
            )
            self._choice("polarisation", "polarisation", CHANNELS)
        with pages.add_tab("target"):
            self._slider("size", "size", 0.25, 3.0, 0.05, "factor on the whole scene, ground included")
            for name in surfaces(state.source):
                self._material(name)
        with pages.add_tab("simulation"):
            self._bounces()
            self._choice("method", "method", ("image", "hybrid", "raster"))
            self._along = gui.add_slider(
                "along the aperture",
                0.0,
                1.0,
                0.01,
                0.5,
                hint="moves the antenna and its beam; nothing is simulated",
            )
            self._along.on_update(lambda _: self._show_beam())
        with pages.add_tab("derivative"):
            self.derivative = DerivativeTab(gui, self._show_image, self._woken.set, self._changed.is_set)
        with pages.add_tab("keep"):
            button = gui.add_button("save scene (XML) and command", hint=f"into {self.folder}")
            button.on_click(lambda event: self.save(event.client))
            self._command = gui.add_text("command", "", multiline=True, disabled=True)

    def _slider(self, label: str, name: str, low: float, high: float, step: float, hint: str) -> None:
        value = getattr(self.state, name)
        low, high = min(low, value), max(high, value)
        slider = self.server.gui.add_slider(label, low, high, step, value, hint=hint)
        slider.on_update(lambda _: self._set(**{name: slider.value}))
        self.controls[name] = slider

    def _choice(self, label: str, name: str, values: tuple[str, ...]) -> None:
        box = self.server.gui.add_dropdown(label, values, initial_value=getattr(self.state, name))
        box.on_update(lambda _: self._set(**{name: box.value}))
        self.controls[name] = box

    def _bounces(self) -> None:
        """Largest number of bounces; the automatic one by its name."""
        depths = {AUTOMATIC: 0, **{str(n): n for n in range(1, max(8, self.state.max_depth) + 1)}}
        now = next(name for name, depth in depths.items() if depth == self.state.max_depth)
        box = self.server.gui.add_dropdown(
            "bounces", tuple(depths), initial_value=now, hint=f"{AUTOMATIC}: as many as matter"
        )
        box.on_update(lambda _: self._set(max_depth=depths[box.value]))
        self.controls["max_depth"] = box

    def _material(self, surface: str) -> None:
        box = self.server.gui.add_dropdown(
            f"{surface} is", (AS_IT_IS, *MATERIALS.names), initial_value=AS_IT_IS
        )

        def changed(_: object) -> None:
            kept = {name: what for name, what in self.state.materials.items() if name != surface}
            self._set(materials=kept if box.value == AS_IT_IS else kept | {surface: box.value})

        box.on_update(changed)
        self.controls[f"material {surface}"] = box

    def _set(self, **changes: object) -> None:
        with self._lock:
            self.state = dataclasses.replace(self.state, **changes)  # type: ignore[arg-type]
        self._changed.set()
        self._woken.set()

    def save(self, client: viser.ClientHandle | None = None) -> None:
        """Write the displayed scene, which may differ from the sliders; ``client`` may download it too."""
        if self.view is None:
            return
        try:
            self.saved = save(self.view.state, self.folder, self.view.state.source.stem)
        except OSError as error:
            self._status.content = f"**not saved:** {self.folder}: {error.strerror}"
            return
        self._command.value = command(self.saved)
        self._status.content = f"saved as {self.saved}"
        if client is not None:
            client.send_file_download(self.saved.name, self.saved.read_bytes())

    # ------------------------------------------------------------ display

    def _show(self, view: View) -> None:
        first, self.view = self.view is None, view
        scene = self.server.scene
        self._show_image(view.image, PictureOptions(), IMAGE)
        self._stale = False
        self._rcs.content = rcs_text(view)
        for body in bodies(view.scene):
            scene.add_mesh_simple(
                f"/bodies/{body.name}",
                self._place(body.vertices),
                body.faces,
                color=body.colour,
                flat_shading=True,
                side="double",
            )
        track = track_shown(view.scene)
        lines = self._place(np.stack([track[:-1], track[1:]], axis=1))
        scene.add_line_segments("/track", lines, _TRACK, thickness=3.0, thickness_units="screen")
        self._show_beam()
        if first:
            antenna = self._place(track.mean(axis=0))
            along, across = view.scene.radar.track.along, view.scene.radar.across
            # from behind the radar's side, with the antenna and the ground in the picture
            self.server.initial_camera.look_at = 0.35 * antenna
            self.server.initial_camera.position = _SIZE * (
                -1.25 * along - 0.1 * across + np.array([0.0, 0.0, 0.75])
            )

    def _show_image(self, image: SarImage, options: PictureOptions, label: str) -> None:
        """Show an image of the displayed view beside the scene and on its ground."""
        assert self.view is not None
        self._picture.label = label
        self._picture.image = pixels(panel(image, options))
        display = prepare(image, dataclasses.replace(options, colour_map="gray"), _LARGEST)
        plane = image_plane(image, grey_levels(display), self.view.scene.geometry.diameter)
        axes = np.stack([plane.right, plane.up, np.cross(plane.right, plane.up)], axis=1)
        self.server.scene.add_image(
            "/image",
            plane.colours,
            plane.width * self._scale,
            plane.height * self._scale,
            wxyz=Rotation.from_matrix(axes).as_quat(scalar_first=True),
            position=self._place(plane.center),
        )

    @property
    def _scale(self) -> float:
        """Scale factor of the display: all scenes are shown at one size."""
        assert self.view is not None
        image = self.view.scene.image
        geometry = self.view.scene.geometry
        # ground without end is as large as the rays need, far larger than what stands on it
        diameter = 0.0 if any(geometry.mesh_endless) else geometry.diameter
        return _SIZE / max(diameter, image.extent_azimuth, image.extent_range)

    def _place(self, points: F64) -> F32:
        """Displayed positions of points (..., 3) of the scene, relative to the aim point."""
        assert self.view is not None
        return np.asarray((points - self.view.scene.radar.aim_point) * self._scale, dtype=np.float32)

    def _show_beam(self) -> None:
        """Show the antenna and its beam at the slider's position along the aperture."""
        if self.view is None:
            return
        beam = beam_at(self.view.scene, float(self._along.value))
        scene = self.server.scene
        vertices, faces = beam.mesh
        scene.add_mesh_simple(
            "/beam",
            self._place(vertices),
            faces,
            color=_BEAM,
            opacity=0.15,
            side="double",
            cast_shadow=False,
            receive_shadow=False,
        )
        rim = np.stack([beam.rim, np.roll(beam.rim, -1, axis=0)], axis=1)
        lines = self._place(np.concatenate([rim, np.stack([beam.antenna, beam.middle])[None]]))
        scene.add_line_segments("/beam/lines", lines, _BEAM, thickness=2.0, thickness_units="screen")
        scene.add_icosphere("/antenna", 0.02 * _SIZE, color=_TRACK, position=self._place(beam.antenna))


def _suppress_banner() -> AbstractContextManager[object]:
    """Suppress the output of viser, for which it has no setting; only the command line prints."""
    return redirect_stdout(StringIO())


def grey_levels(display: Display) -> U8:
    """Brightness of every value of a picture, 0 (black) to 255 (white)."""
    black, white = display.limits
    share = (np.nan_to_num(display.values, neginf=black) - black) / (white - black)
    return np.asarray(255.0 * np.clip(share, 0.0, 1.0), dtype=np.uint8)


def dim_picture(picture: U8) -> U8:
    """A picture that is out of date: pale, with little contrast."""
    return np.asarray(np.round(255.0 - _STALE * (255.0 - picture.astype(np.float64))), dtype=np.uint8)


def rcs_text(view: View) -> str:
    """Radar cross section of the whole scene from the middle of the aperture, as Markdown."""
    channel = view.state.polarisation
    if view.rcs is None:
        return "*no RCS of the whole scene: its ground has no end*"
    lines = [f"**RCS of the whole scene from here, {channel}:** {view.rcs.dbsm(channel)[0]:.1f} dBsm"]
    for order in view.rcs.orders:
        lines.append(
            f"- {order} bounce{'s' if order > 1 else ''}: {view.rcs.dbsm(channel, order)[0]:.1f} dBsm"
        )
    return "\n".join(lines)


def _short(value: float) -> float:
    return float(f"{value:.2g}")
