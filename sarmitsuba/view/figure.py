"""Figure that shows itself in notebooks, without pyplot."""

import io

import matplotlib.figure
from matplotlib.backends.backend_agg import FigureCanvasAgg


class Figure(matplotlib.figure.Figure):
    """Matplotlib figure that a notebook displays as PNG whether or not ``matplotlib.pyplot`` was imported.

    It opens no window and is known to no other figure manager: threads may draw at the same time.
    """

    def png(self) -> bytes:
        """The figure as PNG with its own dots per inch."""
        buffer = io.BytesIO()
        FigureCanvasAgg(self).print_figure(buffer, format="png", dpi=self.dpi)
        return buffer.getvalue()

    _repr_png_ = png
