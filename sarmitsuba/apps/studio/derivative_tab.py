"""Controls of the studio for the derivative of the image by one parameter of the scene: what changes if a wall moves.

Controls only signal; the thread of :meth:`sarmitsuba.apps.studio.server.Studio.serve` differentiates and draws.
"""

import time
from collections.abc import Callable
from dataclasses import replace

import viser

from sarmitsuba.apps.fit.changed_view import IMAGE, PICTURES, ChangedView
from sarmitsuba.apps.fit.image_derivative import image_derivative
from sarmitsuba.apps.fit.parsing import offered
from sarmitsuba.apps.studio.bench import View
from sarmitsuba.core.errors import SarmitsubaError
from sarmitsuba.core.timing import Clock
from sarmitsuba.scene.scene import Scene
from sarmitsuba.signal.image.sar_image import SarImage
from sarmitsuba.view.display import PictureOptions

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
        """Compute and show what the controls ask for, of the last simulated view."""
        if self._offered is not view:
            self._offered, words = view, (NOTHING, *offered(view.scene))
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
            found = image_derivative(_with_raw_data(view.scene), word, leave_out=True, progress=go_on)
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


def _with_raw_data(scene: Scene) -> Scene:
    """The scene with the method ``hybrid``, unless its own makes raw data."""
    settings = scene.settings
    return (
        scene
        if settings.method in ("raw", "hybrid")
        else replace(scene, settings=replace(settings, method="hybrid"))
    )
