"""Derivatives of the raw data of a scene, and of its image, by parameters of the scene."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from numbers import Integral
from typing import TYPE_CHECKING, TypeAlias

from sarmitsuba.apps.fit.derivative_witness import derivative_witnesses, warn_of
from sarmitsuba.apps.fit.forward_model import ForwardModel
from sarmitsuba.apps.fit.parameter import Parameter
from sarmitsuba.apps.fit.parsing import parse
from sarmitsuba.core.arrays import C64, F64
from sarmitsuba.core.errors import SceneError
from sarmitsuba.core.parameters import one_line
from sarmitsuba.core.witness import Witness
from sarmitsuba.machine.exclusive import exclusive
from sarmitsuba.scene.scene import Scene, SceneLike
from sarmitsuba.signal.raw_data import RawData

if TYPE_CHECKING:
    from sarmitsuba.signal.image import SarImage

Parameters: TypeAlias = "str | Sequence[str | Parameter]"


@dataclass(frozen=True, eq=False)
class Jacobian:
    """Raw data of a scene and their derivatives.

    Parameters
    ----------
    names : of the values, with their units in brackets
    values : (n,) float64, at which they are taken
    derivative : (n, channels, pulses, samples) complex64, sqrt(W) per unit
    raw : the raw data themselves, without receiver noise
    witnesses : by kind of parameter, error of the derivatives in a central difference of plain runs, see
        :mod:`sarmitsuba.apps.fit.derivative_witness`
    """

    names: tuple[str, ...]
    values: F64
    derivative: C64
    raw: RawData
    witnesses: Mapping[str, Witness] = field(default_factory=dict)

    def __len__(self) -> int:
        """Number of values."""
        return len(self.names)

    def number(self, which: int | str) -> int:
        """Number of a value, from its name with or without its unit.

        Raises
        ------
        SceneError : no value of that name or number
        """
        if isinstance(which, Integral) and not isinstance(which, bool) and -len(self) <= which < len(self):
            return int(which)
        for i, name in enumerate(self.names):
            if which in (name, name.rsplit(" [", 1)[0]):
                return i
        raise SceneError(f"no parameter {which!r}; there are {', '.join(self.names)}")

    def raw_of(self, which: int | str) -> RawData:
        """Derivative by one value in the form of raw data, which any focuser takes."""
        return replace(self.raw, data=self.derivative[self.number(which)])

    def image(
        self, which: int | str, focusing: Callable[[RawData], SarImage | Sequence[SarImage]] | None = None
    ) -> SarImage | Sequence[SarImage]:
        """Derivative of the image by one value: focusing is linear in the raw data.

        Parameters
        ----------
        which : number or name of the value
        focusing : function of raw data, without autofocus; None: :func:`sarmitsuba.focus` with its defaults
        """
        if focusing is None:
            from sarmitsuba.signal.focusing import focus

            return focus(self.raw_of(which))
        return focusing(self.raw_of(which))


def parameters_of(given: Parameters, scene: Scene) -> tuple[Parameter, ...]:
    """Parameters as objects, from a text, or a sequence of texts and objects.

    Raises
    ------
    SceneError : a text that names no parameter, see :func:`sarmitsuba.apps.fit.parsing.parse`; a value that is given
        twice; something else than texts and objects
    """
    found: list[Parameter] = []
    given = (given,) if isinstance(given, str | Parameter) else given
    for one in given if isinstance(given, Iterable) else (given,):
        if not isinstance(one, str | Parameter):
            raise SceneError(
                f"parameters: {one_line(repr(one))} is neither a text nor a parameter; give a text, "
                "such as 'gain,levels'"
            )
        found += [one] if isinstance(one, Parameter) else parse(one, scene)
    if not found:
        raise SceneError("parameters: none is given; name at least one, such as gain or levels")
    for name, count in Counter(name for parameter in found for name in parameter.names(scene)).items():
        if count > 1:
            raise SceneError(f"parameters: {name} is given {count} times; give every value once")
    return tuple(found)


@exclusive
def jacobian(
    scene: SceneLike,
    parameters: Parameters,
    *,
    values: F64 | None = None,
    edges: bool = True,
    witness: bool = True,
    progress: Callable[[float], None] | None = None,
) -> Jacobian:
    r"""Raw data of a scene and their derivatives by parameters.

    An echo of amplitude a and slant range R contributes :math:`a \, e^{-j 4 \pi f R / c}` at the frequency f, and

    .. math:: \left(\partial a - j \frac{4 \pi f}{c} \, a \, \partial R\right) e^{-j 4 \pi f R / c}

    to the derivative. :math:`\partial R` follows from the velocities of the antenna, of its images in the mirrors of
    the path and of the scatterer, in float64; diffuse scatterers move with their shape.

    Parameters
    ----------
    scene : as loaded, a scene file, or the name of a shipped scene
    parameters : text such as ``"levels,track:5"``, or texts and objects, see :func:`sarmitsuba.apps.fit.parsing.parse`
    values : (n,) of the parameters at which they are taken; None: those of the scene
    edges : with the parts that the edges of moving shapes hide and show; without, the derivatives of a town take a few
    runs less
    witness : whether the derivatives by each kind of parameter are measured against a central difference: two plain
        runs each, and for moving shapes their derivatives without edges
    progress : called with the share that is done

    Returns
    -------
    jacobian : derivatives, with the raw data that they belong to

    Raises
    ------
    SceneError, RadarError
        An unknown parameter, or a scene with echoes that cannot be differentiated.
    ResourceError
        The derivatives do not fit into memory.

    Notes
    -----
    Shadow boundaries and the boundaries of lit areas move with the edges that cast them, in the mean over the place of
    the ray lattice (:mod:`sarmitsuba.tracing.derivatives.edge_tangents`): on all legs of up to three bounces, but
    not what hides a
    diffuse scatterer that is lit over a mirror from the antenna. Of displacements it ignores the change of amplitudes
    by spreading and beam, which is :math:`\lambda / 4 \pi R` of the change of phase. Within a block of pulses that
    share one tracing, derivatives of slant ranges are linear in time about its key pulse; an aperture of the angle
    :math:`\theta` leaves :math:`\theta^2 / 8` at the ends, 3e-5 at a degree.
    """
    scene = Scene.of(scene)
    model = ForwardModel(scene, parameters_of(parameters, scene))
    values = model.start if values is None else model.checked(values)
    data, derivative = model.derivative(values, progress, edges=edges)
    found: dict[str, Witness] = {}
    if witness:
        found = derivative_witnesses(model, values, data, derivative, scene.settings.seed, edges=edges)
        warn_of(scene.name, found)
    return Jacobian(model.names, values, derivative, model.raw(data), found)
