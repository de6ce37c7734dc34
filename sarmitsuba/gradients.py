"""Raw data of a scene as a differentiable function in PyTorch and in JAX.

``torch_function`` and ``jax_function`` return a function of parameter values whose derivative is a run back by
:mod:`sarmitsuba.apps.fit.reverse`. Neither framework is needed by the package; each is imported on first use.
"""

import importlib
from collections.abc import Callable
from typing import Any

import numpy as np

from sarmitsuba.apps.fit.forward_model import ForwardModel
from sarmitsuba.apps.fit.jacobian import Parameters, parameters_of
from sarmitsuba.apps.fit.reverse import apply_transpose
from sarmitsuba.core.arrays import C64, C128, F64
from sarmitsuba.core.errors import BackendError
from sarmitsuba.machine.exclusive import backend_lock
from sarmitsuba.scene.scene import Scene, SceneLike

# tensors, arrays and modules of a framework that may not be installed
Foreign = Any


class _Model:
    """Raw data and transposed derivatives as functions of NumPy arrays, for one thread at a time."""

    def __init__(self, scene: SceneLike, parameters: Parameters, edges: bool) -> None:
        with backend_lock():
            scene = Scene.of(scene)
            self.model = ForwardModel(scene, parameters_of(parameters, scene))
        self.edges = edges

    def check_shape(self, shape: tuple[int, ...]) -> None:
        """Raise a SceneError for values of another shape than the parameters'."""
        self.model.checked(np.zeros(shape))

    def data(self, values: F64) -> C64:
        """Raw data (channels, pulses, samples) at values (n,)."""
        with backend_lock():
            return self.model.data(np.asarray(values, dtype=np.float64))

    def pull_back(self, values: F64, adjoint: C64 | C128) -> F64:
        """Derivatives (n,) of the loss whose adjoint data (channels, pulses, samples) are dL/dRe + j dL/dIm."""
        with backend_lock():
            whole: C128 = np.asarray(adjoint, dtype=np.complex128)
            product, _ = apply_transpose(
                self.model, whole, np.asarray(values, dtype=np.float64), edges=self.edges
            )
        return product


def torch_function(
    scene: SceneLike, parameters: Parameters, *, edges: bool = True
) -> Callable[[Foreign], Foreign]:
    """Raw data of a scene as a function of a PyTorch tensor of parameter values, with its derivative.

    Parameters
    ----------
    scene : as loaded, a scene file, or the name of a shipped scene
    parameters : as for :func:`sarmitsuba.jacobian`; its ``values`` are those of the scene
    edges : with what the edges of moving shapes hide and show, as for :func:`sarmitsuba.gradient`

    Returns
    -------
    function of values (n,), float32 or float64, that returns raw data (channels, pulses, samples), sqrt(W), complex64
    or complex128 alike. It is differentiable once; data go through the processor's memory.

    Raises
    ------
    BackendError
        PyTorch is not installed.

    Notes
    -----
    Echoes are computed in complex64 in either precision. Ignores the same as :func:`sarmitsuba.jacobian`.
    """
    torch = _framework("torch", "PyTorch")
    model = _Model(scene, parameters, edges)

    class RawDataOf(torch.autograd.Function):  # type: ignore[name-defined]
        """Raw data, and the transpose of their derivative."""

        @staticmethod
        def forward(context: Foreign, values: Foreign) -> Foreign:
            model.check_shape(tuple(values.shape))
            context.save_for_backward(values)
            data = torch.from_numpy(model.data(values.detach().cpu().double().numpy()))
            kind = torch.complex128 if values.dtype == torch.float64 else torch.complex64
            return data.to(device=values.device, dtype=kind)

        @staticmethod
        def backward(context: Foreign, adjoint: Foreign) -> Foreign:
            (values,) = context.saved_tensors
            found = model.pull_back(
                values.detach().cpu().double().numpy(), adjoint.detach().cpu().resolve_conj().numpy()
            )
            return torch.from_numpy(found).to(device=values.device, dtype=values.dtype)

    def raw_data(values: Foreign) -> Foreign:
        """Raw data at values."""
        return RawDataOf.apply(values)

    return raw_data


def jax_function(
    scene: SceneLike, parameters: Parameters, *, edges: bool = True
) -> Callable[[Foreign], Foreign]:
    """Raw data of a scene as a function of a JAX array of parameter values, with its derivative.

    Parameters, returns and notes as for :func:`torch_function`. It may be part of a function under ``jax.jit`` and
    ``jax.grad``; float64 needs ``jax_enable_x64``.

    Raises
    ------
    BackendError
        JAX is not installed.
    """
    jax = _framework("jax", "JAX")
    model = _Model(scene, parameters, edges)

    def call(values: Foreign) -> Foreign:
        model.check_shape(tuple(values.shape))
        kind = np.complex128 if values.dtype == np.float64 else np.complex64
        shape = jax.ShapeDtypeStruct(model.model.shape, kind)
        return jax.pure_callback(lambda v: model.data(np.asarray(v)).astype(kind), shape, values)

    def keep(values: Foreign) -> tuple[Foreign, Foreign]:
        return call(values), values

    def pull_back(values: Foreign, cotangent: Foreign) -> tuple[Foreign]:
        def product(v: Foreign, c: Foreign) -> Foreign:  # JAX's cotangent is dL/dRe - j dL/dIm
            return model.pull_back(np.asarray(v), np.conj(np.asarray(c))).astype(values.dtype)

        shape = jax.ShapeDtypeStruct(values.shape, values.dtype)
        return (jax.pure_callback(product, shape, values, cotangent),)

    raw_data: Foreign = jax.custom_vjp(call)
    raw_data.defvjp(keep, pull_back)

    def function(values: Foreign) -> Foreign:
        """Raw data at values."""
        return raw_data(values)

    return function


def _framework(name: str, title: str) -> Foreign:
    """Imported module of a framework.

    Raises
    ------
    BackendError : it is not installed
    """
    try:
        return importlib.import_module(name)
    except ImportError as error:
        raise BackendError(f"gradients: {title} cannot be imported ({error}); pip install {name}") from None
