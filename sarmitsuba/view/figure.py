"""Figure that shows itself in notebooks, without pyplot."""

import io
from collections.abc import Sequence

import matplotlib.figure
import numpy as np
from matplotlib.axis import Axis
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.ticker import MaxNLocator

# options of PNG files: the usual compression level 6 takes twice the time for 4 % less
PACKED = {"compress_level": 3}


class Figure(matplotlib.figure.Figure):
    """Matplotlib figure that a notebook displays as PNG whether or not ``matplotlib.pyplot`` was imported.

    It opens no window and is known to no other figure manager: threads may draw at the same time.
    """

    def png(self) -> bytes:
        """The figure as PNG with its own dots per inch."""
        buffer = io.BytesIO()
        FigureCanvasAgg(self).print_figure(buffer, format="png", dpi=self.dpi, pil_kwargs=PACKED)
        return buffer.getvalue()

    _repr_png_ = png


class RoomyTicks(MaxNLocator):
    """Ticks of an x axis as many as have room for numbers of five digits; one, in the middle, on narrow axes."""

    room = 55.0  # screen pixels at 100 dots per inch for a tick and its number

    def __init__(self) -> None:
        super().__init__(nbins=5, steps=[1, 2, 2.5, 5, 10])

    def tick_values(self, vmin: float, vmax: float) -> Sequence[float]:
        """Places of the ticks between two limits."""
        assert isinstance(self.axis, Axis)
        axes = self.axis.axes
        fit = axes.bbox.width * 100.0 / axes.figure.dpi / self.room
        self.set_params(nbins=int(np.clip(fit, 1, 5)))
        places = np.asarray(super().tick_values(vmin, vmax))
        inside = places[(places >= min(vmin, vmax)) & (places <= max(vmin, vmax))]
        if inside.size > max(fit, 1.0):
            return [float(inside[np.argmin(np.abs(inside - 0.5 * (vmin + vmax)))])]
        return [float(place) for place in places]
