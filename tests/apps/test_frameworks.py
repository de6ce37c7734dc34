"""Raw data as a function in PyTorch and in JAX: values, derivatives, precisions, and what is said without them."""

from __future__ import annotations

import importlib
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from sarmitsuba import Scene, gradient, jacobian
from sarmitsuba.core.arrays import C64, C128, F64
from sarmitsuba.core.errors import BackendError, SceneError
from sarmitsuba.gradients import jax_function, torch_function
from tests.support.many_bodies import city

pytestmark = pytest.mark.filterwarnings("ignore::sarmitsuba.core.errors.SarmitsubaWarning")
PARAMETERS = "level:soil,gain"


@pytest.fixture(scope="module")
def scene() -> Scene:
    return city(2, 1, pitch=8.0, settings={"max_depth": 2})


@pytest.fixture(scope="module")
def weight(scene: Scene) -> float:
    """That makes the loss of a size of 1."""
    raw = jacobian(scene, PARAMETERS, witness=False).raw.data
    return float(1.0 / np.sum(np.abs(raw.astype(np.complex128)) ** 2))


def loss_of(weight: float) -> Any:
    """Energy of the data, weighed by the number of the pulse: value and adjoint data."""

    def loss(data: C64) -> tuple[float, C128]:
        row = weight * np.arange(data.shape[1])[None, :, None]
        whole: C128 = data.astype(np.complex128)
        return float(np.sum(row * np.abs(whole) ** 2)), (2.0 * row * whole).astype(np.complex128)

    return loss


def test_jacobian_at_other_values(scene: Scene) -> None:
    at, there = np.array([-7.0, 0.5]), jacobian(scene, PARAMETERS, witness=False)
    found = jacobian(scene, PARAMETERS, values=at, witness=False)
    np.testing.assert_array_equal(found.values, at)
    # tol: float32 data; the gain multiplies all by 0.5 dB, the level the soil alone
    np.testing.assert_allclose(
        np.linalg.norm(found.derivative[1]) / np.linalg.norm(found.raw.data), np.log(10.0) / 20.0, rtol=1e-5
    )
    assert np.linalg.norm(found.raw.data) != pytest.approx(np.linalg.norm(there.raw.data), rel=1e-3)
    np.testing.assert_array_equal(
        jacobian(scene, PARAMETERS, values=there.values, witness=False).raw.data, there.raw.data
    )
    with pytest.raises(SceneError, match="1 values for 2 parameters"):
        jacobian(scene, PARAMETERS, values=np.zeros(1))


@pytest.mark.parametrize("make, name", [(torch_function, "PyTorch"), (jax_function, "JAX")])
def test_without_the_framework_one_line_says_so(
    make: Any, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    def missing(module: str) -> Any:
        raise ModuleNotFoundError(f"No module named {module!r}")

    monkeypatch.setattr(importlib, "import_module", missing)
    with pytest.raises(BackendError, match=rf"gradients: {name} cannot be imported .*; pip install "):
        make("tower", "levels")


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["float32", "float64"])
def test_jax_gives_the_gradient_of_a_loss_written_in_jax(scene: Scene, weight: float, kind: str) -> None:
    jax = pytest.importorskip("jax")
    with jax.enable_x64(kind == "float64"):
        raw = jax_function(scene, PARAMETERS)
        start = jacobian(scene, PARAMETERS, witness=False).values

        def loss(values: Any) -> Any:
            data = raw(values)
            row = weight * jax.numpy.arange(data.shape[1])[None, :, None]
            return (row * abs(data) ** 2).sum()

        value, found = jax.jit(jax.value_and_grad(loss))(jax.numpy.asarray(start, dtype=kind))
        assert (
            raw(jax.numpy.asarray(start, dtype=kind)).dtype
            == {"float32": "complex64", "float64": "complex128"}[kind]
        )
    expected = gradient(scene, PARAMETERS, loss_of(weight), witness=False)
    assert found.dtype == kind
    # tol: float32 sums of the loss and of adjoint grids
    np.testing.assert_allclose(found, expected.gradient, rtol=1e-4)
    assert float(value) == pytest.approx(expected.loss, rel=1e-4)


@pytest.mark.parametrize("kind", ["float32", "float64"])
def test_torch_gives_the_gradient_of_a_loss_written_in_torch(scene: Scene, weight: float, kind: str) -> None:
    torch = pytest.importorskip("torch")
    raw = torch_function(scene, PARAMETERS)
    start = jacobian(scene, PARAMETERS, witness=False).values
    values = torch.tensor(start, dtype=getattr(torch, kind), requires_grad=True)
    data = raw(values)
    assert data.dtype == {"float32": torch.complex64, "float64": torch.complex128}[kind]
    row = weight * torch.arange(data.shape[1])[None, :, None]
    (row * data.abs() ** 2).sum().backward()
    expected = gradient(scene, PARAMETERS, loss_of(weight), witness=False).gradient
    assert values.grad.dtype == values.dtype
    np.testing.assert_allclose(values.grad.numpy(), expected, rtol=1e-4)  # tol: float32 sums
    with pytest.raises(SceneError, match="3 values for 2 parameters"):
        raw(torch.zeros(3))


class FakeTensor:
    """As much of a tensor as the function touches."""

    def __init__(self, array: Any) -> None:
        self.array, self.device = np.asarray(array), "cpu"
        self.shape, self.dtype = self.array.shape, self.array.dtype.name

    def detach(self) -> FakeTensor:
        return self

    cpu = resolve_conj = detach

    def double(self) -> FakeTensor:
        return FakeTensor(self.array.astype(np.float64))

    def numpy(self) -> Any:
        return self.array

    def to(self, *, device: str, dtype: str) -> FakeTensor:
        return FakeTensor(self.array.astype(dtype))


@pytest.mark.parametrize("kind", ["float32", "float64"])
def test_torch_function_on_a_small_fake(
    scene: Scene, weight: float, kind: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Forward and backward as PyTorch calls them, where it is not installed."""

    class Function:
        context: Any = None

        @classmethod
        def apply(cls, values: FakeTensor) -> Any:
            context = SimpleNamespace(saved_tensors=())
            context.save_for_backward = lambda *kept: setattr(context, "saved_tensors", kept)
            Function.context = (cls, context)
            return cls.forward(context, values)  # type: ignore[attr-defined]

    fake = SimpleNamespace(
        autograd=SimpleNamespace(Function=Function),
        from_numpy=FakeTensor,
        **{name: name for name in ("float32", "float64", "complex64", "complex128")},
    )
    real = importlib.import_module
    monkeypatch.setattr(importlib, "import_module", lambda name: fake if name == "torch" else real(name))
    start: F64 = jacobian(scene, PARAMETERS, witness=False).values
    data = torch_function(scene, PARAMETERS)(FakeTensor(start.astype(kind)))
    assert data.dtype == {"float32": "complex64", "float64": "complex128"}[kind]
    _, adjoint = loss_of(weight)(data.array)
    cls, context = Function.context
    found = cls.backward(context, FakeTensor(adjoint))
    assert found.dtype == kind
    expected = gradient(scene, PARAMETERS, loss_of(weight), witness=False).gradient
    np.testing.assert_allclose(found.array, expected, rtol=1e-5)  # tol: float32 values
