"""Derivative of the focused image of a scene by one parameter, and the image to first order at other values of it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from sarmitsuba.apps.fit.derivative_witness import corner_velocities
from sarmitsuba.apps.fit.forward_model import ForwardModel
from sarmitsuba.apps.fit.jacobian import Parameters, parameters_of
from sarmitsuba.apps.fit.material_parameters import MaterialProperty, material_of
from sarmitsuba.apps.fit.shape_parameters import DEFORMATIONS
from sarmitsuba.core.arrays import C64, F64, unit_rows
from sarmitsuba.core.constants import DEFAULT_WINDOW
from sarmitsuba.core.errors import SceneError
from sarmitsuba.machine.exclusive import exclusive
from sarmitsuba.scene.scene import Scene, SceneLike
from sarmitsuba.signal.focusing import focus
from sarmitsuba.signal.image import SarImage

# phase, rad, up to which first order is of use: an eighth of a wavelength of path
LARGEST_PHASE = 0.25 * np.pi


@dataclass(frozen=True, eq=False)
class ImageDerivative:
    r"""Image of a scene and its derivative by one value.

    The image at a change v of the value is :math:`I + v \, I'` to first order.

    Parameters
    ----------
    name : of the value, with its unit in brackets
    value : of the scene as it is
    image, derivative : on one grid; the derivative per unit
    rate : largest relative change of an echo, 1 per unit; the phase in rad for a displacement, see :func:`rate_of`
    scale : change of the value over which echoes stop being straight in it, see :func:`scale_of`
    left_out : effects of the scene that have no derivative and were left out of both
    """

    name: str
    value: float
    image: SarImage
    derivative: SarImage
    rate: float
    scale: float = np.inf
    left_out: tuple[str, ...] = ()
    _model: ForwardModel | None = field(default=None, repr=False)
    _windows: Mapping[str, str] = field(default_factory=dict, repr=False)

    @property
    def unit(self) -> str:
        """Unit of the value."""
        return self.name.rsplit("[", 1)[1].rstrip("]")

    @property
    def displaces(self) -> bool:
        """Whether the value is a place or a form of a shape."""
        return self.name.partition(":")[0] in ("shift", *DEFORMATIONS)

    @property
    def changes(self) -> bool:
        """Whether the image depends on the value."""
        return bool(self.derivative.data.any())

    @property
    def largest_change(self) -> float:
        """Change of the value up to which first order is of use: ``LARGEST_PHASE`` of the phase; infinite without."""
        by_rate = LARGEST_PHASE / self.rate if self.rate > 0.0 else np.inf
        return min(by_rate, 0.5 * LARGEST_PHASE * self.scale)

    def error(self, change: float) -> float:
        r"""Error of the change of the image to first order, as a share of the change.

        .. math:: |e^{jx} - 1 - j x| / |e^{jx} - 1| \approx x / 2, \quad x = \mathrm{rate} \cdot v

        or, where it is larger, :math:`v / \mathrm{scale}`: echoes that go with the n-th power of a property p are off
        by :math:`(n - 1) v / 2 p`.

        Notes
        -----
        For echoes that all change by the rate; those that change less make it an upper bound. Of properties of
        materials it is an estimate, for powers of up to 3; that of the material's law is not known. Ignores whatever
        derivatives leave out, see :func:`sarmitsuba.jacobian`.
        """
        return max(0.5 * self.rate, 1.0 / self.scale) * abs(change)

    def image_at(self, change: float) -> SarImage:
        """Image at a change of the value, to first order."""
        return replace(self.image, data=self.image.data + np.complex64(change) * self.derivative.data)

    def difference_at(self, change: float) -> SarImage:
        """Image at a change of the value less the image as it is, to first order."""
        return replace(self.derivative, data=np.complex64(change) * self.derivative.data)

    def phase_at(self, change: float) -> SarImage:
        """Image whose phase is the change of the phase, to first order: the new image times the conjugate old one."""
        return replace(self.image, data=self.image_at(change).data * self.image.data.conj())

    @exclusive
    def simulated_at(self, change: float) -> SarImage:
        """Image at a change of the value, simulated with the same rays and scatterers.

        Raises
        ------
        SceneError : a value that the parameter cannot have
        """
        assert self._model is not None
        values: F64 = self._model.start + change
        return self._focus_data(self._model.data(values))

    def _focus_data(self, data: C64) -> SarImage:
        assert self._model is not None
        return focus(self._model.raw(data), **self._windows)  # type: ignore[arg-type]


@exclusive
def image_derivative(
    scene: SceneLike,
    parameter: Parameters,
    *,
    leave_out: bool = False,
    window: str = DEFAULT_WINDOW,
    progress: Callable[[float], None] | None = None,
) -> ImageDerivative:
    """Image of a scene and its derivative by one value, on the grid that the scene asks for.

    Parameters
    ----------
    scene : as for :func:`sarmitsuba.jacobian`
    parameter : with one value, as for :func:`sarmitsuba.jacobian`
    leave_out : effects that have no derivative are left out, instead of an error
    window : of the image, in azimuth and range
    progress : called with the share of the tracing that is done; an exception from it ends the computation

    Returns
    -------
    ImageDerivative : noise of the receiver is in neither image

    Raises
    ------
    SceneError, RadarError
        As for :func:`sarmitsuba.jacobian`; or a parameter of several values.
    ResourceError
        The derivatives do not fit into memory.

    Notes
    -----
    Ignores the same as :func:`sarmitsuba.jacobian`.
    """
    scene = Scene.of(scene)
    model = ForwardModel(scene, parameters_of(parameter, scene), leave_out=leave_out)
    if len(model.names) != 1:
        raise SceneError(
            f"{scene.name}: the derivative of an image is by one value, not by {len(model.names)}: "
            f"{', '.join(model.names)}"
        )
    data, derivative = model.derivative(progress=progress)
    windows = {"range_window": window, "azimuth_window": window}
    image, change = (focus(model.raw(plane), **windows) for plane in (data, derivative[0]))  # type: ignore[arg-type]
    rate, scale = rate_of(model, image, change), scale_of(model)
    return ImageDerivative(
        model.names[0], float(model.start[0]), image, change, rate, scale, model.left_out, model, windows
    )


def scale_of(model: ForwardModel) -> float:
    """Change of a value over which echoes stop being straight in it, beside the turn of their phases.

    The property of a material itself, or where that is 0 (a loss) the permittivity's modulus; infinite for others.
    """
    (parameter,) = model.parameters
    if not isinstance(parameter, MaterialProperty):
        return np.inf
    material = material_of(model.scene, parameter.material, parameter.label)
    return float(model.start[0]) or abs(material.permittivity)


def rate_of(model: ForwardModel, image: SarImage, derivative: SarImage) -> float:
    r"""Largest relative change of an echo with a value, 1 per unit.

    Of a displacement the phase of a single bounce, :math:`\max 4 \pi |u \cdot \dot{p}| / \lambda` over the corners p of
    the shape and the pulses; of a value in dB :math:`\ln 10 / 20`; of others the median of :math:`|I'| / |I|` over the
    pixels, weighted by :math:`|I'|^2`, which is less than that of single echoes where pixels hold others too.

    Notes
    -----
    Ignores that the phase of an echo between moved and fixed surfaces can change twice as fast.
    """
    scene, (parameter,) = model.scene, model.parameters
    moves = parameter.displacements(scene, scene.geometry.face_mesh)
    if moves:
        track = scene.radar.track
        pulses = track.position[[0, track.center_index, -1]] - scene.radar.aim_point
        sight = unit_rows(pulses)
        wavenumber = 4.0 * np.pi / scene.radar.waveform.wavelength
        return wavenumber * max(
            float(np.abs(corner_velocities(scene, move) @ sight.T).max()) for move in moves
        )
    if model.names[0].endswith("[dB]"):
        return float(np.log(10.0) / 20.0)
    change, pixel = (np.abs(one.data.ravel()).astype(np.float64) for one in (derivative, image))
    seen = (change > 0.0) & (pixel > 0.0)
    if not seen.any():
        return 0.0
    change, ratio = change[seen], change[seen] / pixel[seen]
    order = np.argsort(ratio)
    weight = np.cumsum(change[order] ** 2)
    return float(ratio[order[np.searchsorted(weight, 0.5 * weight[-1])]])
