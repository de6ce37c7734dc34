"""Image of a scene with one value changed, to first order or simulated: pictures, words, the range of a slider."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from sarmitsuba.core.units import db_from_power
from sarmitsuba.signal.image import SarImage
from sarmitsuba.view.charts import side_by_side
from sarmitsuba.view.display import LARGEST, PictureOptions, prepare
from sarmitsuba.view.figure import Figure

if TYPE_CHECKING:
    from sarmitsuba.apps.fit.image_derivative import ImageDerivative

IMAGE, DIFFERENCE, PHASE = "image", "change of the image", "change of the phase"
PICTURES = (IMAGE, DIFFERENCE, PHASE)

# displacements of shapes that the slider spans to either side, m
SPAN = 0.02
# of other values: this multiple of what first order is of use for
BEYOND = 4.0
# most of values in dB, and share of values that stay above their least
MOST_DB, LEAST_SHARE = 10.0, 0.9
# slider without an effect on the image
IDLE = 1.0
# least values of properties, by kind; others are free
LOWEST = {
    "permittivity": 1.0,
    "loss": 0.0,
    "rms_height": 0.0,
    "correlation_length": 0.0,
    "thickness": 0.0,
    "scale": 0.0,
}
# displayed units and their number in a unit of the value, by kinds
_CENTIMETRE, _MILLIMETRE, _DEGREE = ("cm", 100.0), ("mm", 1000.0), ("deg", 180.0 / np.pi)
_SHOWN = {
    "shift": _CENTIMETRE,
    "height": _CENTIMETRE,
    "rms_height": _MILLIMETRE,
    "correlation_length": _MILLIMETRE,
    "thickness": _MILLIMETRE,
    "rotation": _DEGREE,
}
# steps of a slider from one end to the other
_STEPS = 200


@dataclass(frozen=True)
class ChangeSlider:
    """Range of a slider over the change of a value, in the displayed unit.

    Parameters
    ----------
    unit : displayed
    per_unit : displayed numbers in a unit of the value
    low, high, step : of the slider
    """

    unit: str
    per_unit: float
    low: float
    high: float
    step: float

    @staticmethod
    def of(found: ImageDerivative) -> ChangeSlider:
        """Slider of a parameter: 2 cm for places and heights of shapes, else beyond where first order is of use."""
        kind = found.name.partition(":")[0].partition(" ")[0]
        unit, per_unit = _SHOWN.get(kind, (found.unit, 1.0))
        high = SPAN if unit == "cm" else BEYOND * found.largest_change
        if found.unit == "dB":
            high = min(high, MOST_DB)
        if not np.isfinite(high):
            high = IDLE
        low = -high
        if kind in LOWEST:
            low = max(low, LEAST_SHARE * (LOWEST[kind] - found.value))
        high, low = _short(high * per_unit), -_short(-low * per_unit)
        return ChangeSlider(unit, per_unit, low, high, (high - low) / _STEPS)

    def said(self, change: float) -> str:
        """Change of the value as text, with its sign and unit."""
        return f"{change * self.per_unit:+.3g} {self.unit}"


@dataclass(frozen=True, eq=False)
class ChangedView:
    """Image with one value changed: to first order, or simulated.

    Parameters
    ----------
    derivative : of the image
    slider : over the change
    limits : dB of black and white, those of the image as it is
    change : of the value, in its unit
    simulated : image at that change; None: to first order
    """

    derivative: ImageDerivative
    slider: ChangeSlider
    limits: tuple[float, float]
    change: float = 0.0
    simulated: SarImage | None = None

    @staticmethod
    def of(found: ImageDerivative) -> ChangedView:
        """View of the image as it is."""
        limits = prepare(found.image, PictureOptions(), LARGEST).limits
        return ChangedView(found, ChangeSlider.of(found), limits)

    def at(self, shown: float) -> ChangedView:
        """View at a position of the slider, in its unit, to first order."""
        return self.by(shown / self.slider.per_unit)

    def by(self, change: float) -> ChangedView:
        """View at a change of the value, to first order."""
        return replace(self, change=change, simulated=None)

    def with_simulation(self) -> ChangedView:
        """View at the same change, simulated with the same rays and scatterers.

        Raises
        ------
        SceneError : a value that the parameter cannot have
        """
        return replace(self, simulated=self.derivative.simulated_at(self.change))

    def picture(self, which: str) -> tuple[SarImage, PictureOptions]:
        """One of ``PICTURES`` with its options: decibels on one scale with the image as it is, or radians."""
        found, new = self.derivative, self.simulated
        grey = PictureOptions(limits=self.limits)
        if which == IMAGE:
            return (found.image_at(self.change) if new is None else new), grey
        if which == DIFFERENCE:
            if new is None:
                return found.difference_at(self.change), grey
            return replace(new, data=new.data - found.image.data), grey
        turned = found.phase_at(self.change)
        if new is not None:
            turned = replace(turned, data=new.data * found.image.data.conj())
        return turned, PictureOptions(quantity="phase")

    def lines(self) -> tuple[str, ...]:
        """Change, its size, and how exact it is, in a few lines."""
        found, said = self.derivative, self.slider.said(self.change)
        if not found.changes:
            return ("the image does not depend on it",)
        size = _level(found.difference_at(self.change), found.image)
        if self.simulated is None:
            what = f"energy of the change {size} of the image's" if self.change else "the image as it is"
            lines = [f"{said} to first order: {what}", self._exactness()]
        else:
            true = replace(self.simulated, data=self.simulated.data - found.image.data)
            share = self.simulated_error()
            lines = [
                f"{said} simulated: energy of the change {_level(true, found.image)} of the image's",
                f"to first order {size}; the difference of both is {_percent(share)} of the change",
            ]
        if found.left_out:
            lines.append(f"without {', '.join(name.replace('_', ' ') for name in found.left_out)}")
        return tuple(lines)

    def simulated_error(self) -> float:
        """Error of the change to first order, as a share of the simulated change; NaN where that is 0."""
        assert self.simulated is not None
        new = self.simulated.data.astype(np.complex128)
        true = np.linalg.norm(new - self.derivative.image.data)
        left = np.linalg.norm(new - self.derivative.image_at(self.change).data)
        return float(left / true) if true > 0.0 else np.nan

    def as_dict(self) -> dict[str, object]:
        """JSON-able form; numbers that are not known are None."""
        found = self.derivative
        return {
            "parameter": found.name,
            "value": found.value,
            "change": self.change,
            "rate": found.rate,
            "largest_change": found.largest_change if np.isfinite(found.largest_change) else None,
            "stated_error": found.error(self.change),
            "simulated_error": self.simulated_error() if self.simulated is not None else None,
            "left_out": list(found.left_out),
        }

    def _exactness(self) -> str:
        found = self.derivative
        largest = f"{found.largest_change * self.slider.per_unit:.2g} {self.slider.unit}"
        what = "an eighth of a wavelength of path" if found.displaces else "pixels change by three quarters"
        bound = f"of use to +-{largest}, {what}"
        if abs(self.change) > found.largest_change * (1.0 + 1e-9):
            return f"beyond first order, {bound}: simulate it"
        return f"off by up to {_percent(found.error(self.change))} of the change; {bound}"


def derivative_figure(view: ChangedView) -> Figure:
    """Image as it is, change of the image on the same scale, and change of the phase, side by side."""
    pictures = [("image", *view.by(0.0).picture(IMAGE))]
    pictures += [(which, *view.picture(which)) for which in PICTURES[1:]]
    first, *rest = view.lines()
    return side_by_side(pictures, "\n".join((f"{view.derivative.name.rsplit(' [', 1)[0]} {first}", *rest)))


def _energy(image: SarImage) -> float:
    return float(np.sum(np.abs(image.data.astype(np.complex128)) ** 2))


def _level(change: SarImage, image: SarImage) -> str:
    """Energy of a change over that of the image, dB."""
    share = _energy(change) / _energy(image)
    return f"{float(db_from_power(share)):.1f} dB" if share > 0.0 else "none"


def _percent(share: float) -> str:
    return f"{100.0 * share:.0f} %" if share < 2.0 else "more than 200 %"


def _short(value: float) -> float:
    return float(f"{value:.1g}")
