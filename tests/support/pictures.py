"""Texts of a drawn figure that overlap each other or leave it."""

from collections.abc import Callable, Iterator

import matplotlib.figure
from matplotlib.backend_bases import RendererBase
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.text import Text
from matplotlib.transforms import Bbox

# pixels at 100 dots per inch: extents enclose a font's line, not the ink of its letters
SPARE = 1.5


def find_text_faults(figure: matplotlib.figure.Figure) -> list[str]:
    """Overlapping pairs of texts, and texts that leave the figure, a line each."""
    canvas = figure.canvas if isinstance(figure.canvas, FigureCanvasAgg) else FigureCanvasAgg(figure)
    draw: Callable[[], None] = canvas.draw
    draw()
    find: Callable[[], RendererBase] = canvas.get_renderer
    renderer = find()
    found = [(text.get_text(), text.get_window_extent(renderer)) for text in _shown_texts(figure)]
    whole, spare = figure.bbox, SPARE * figure.dpi / 100.0
    faults = []
    for text, box in found:
        outside = max(whole.x0 - box.x0, whole.y0 - box.y0, box.x1 - whole.x1, box.y1 - whole.y1)
        if outside > spare:
            faults.append(f"{text!r} leaves the figure by {outside:.0f} pixels")
    for i, (one, a) in enumerate(found):
        for other, b in found[i + 1 :]:
            common = Bbox.intersection(a, b)
            if common is not None and min(common.width, common.height) > spare:
                faults.append(
                    f"{one!r} overlaps {other!r} by {common.width:.0f} x {common.height:.0f} pixels"
                )
    return faults


def _shown_texts(figure: matplotlib.figure.Figure) -> Iterator[Text]:
    """Texts that are drawn: of all artists but ticks, and of the ticks within the axes' limits."""
    ticks: set[Text] = set()
    shown: list[Text] = []
    for axes in figure.axes:
        for axis in axes._axis_map.values():
            for tick in (*axis.majorTicks, *axis.minorTicks):
                ticks |= {tick.label1, tick.label2}
            if axes.get_visible() and axes.axison:
                for tick in getattr(axis, "_update_ticks")():  # noqa: B009
                    shown += [text for text in (tick.label1, tick.label2) if text.get_visible()]
            ticks |= {axis.label} if not axes.axison else set()
    for text in (*shown, *(t for t in figure.findobj(Text) if t not in ticks)):
        if text.get_visible() and text.get_text().strip():
            yield text
