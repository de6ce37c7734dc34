"""Derivatives of one number of the raw data by many parameters: one run back, whatever their number."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache, partial
from typing import TYPE_CHECKING

import numpy as np

from sarmitsuba.apps.fit.derivative_witness import gradient_witnesses, warn_of
from sarmitsuba.apps.fit.forward_model import ForwardModel, make_range_derivative
from sarmitsuba.apps.fit.jacobian import Parameters, parameters_of
from sarmitsuba.apps.fit.losses import SquaredDifference, check_loss
from sarmitsuba.apps.fit.moving_edges import EdgeLattices, OfShapes
from sarmitsuba.apps.fit.parsing import At
from sarmitsuba.core.arrays import C64, C128, F64, I64
from sarmitsuba.core.constants import SPEED_OF_LIGHT
from sarmitsuba.core.errors import DataError
from sarmitsuba.core.witness import Witness
from sarmitsuba.machine.exclusive import backend_lock, exclusive, threads
from sarmitsuba.machine.memory import check_fits
from sarmitsuba.scene.materials.map_materials import list_with_parts
from sarmitsuba.scene.scene import Scene, SceneLike
from sarmitsuba.signal.raw_data import RawData
from sarmitsuba.simulation.execution.tracing import Batch, BatchTracer, EveryPulse, KeyPulse, Pulses, Traced
from sarmitsuba.tracing.derivatives.echo_derivatives import AdjointGrids, GradientSum
from sarmitsuba.tracing.derivatives.tangent_slots import MovingShapes, SlotTangents

if TYPE_CHECKING:
    from sarmitsuba.apps.fit.losses import Loss
    from sarmitsuba.signal.sub_bands import RangeFilter
    from sarmitsuba.simulation.execution.tracing import Tracer
    from sarmitsuba.simulation.planning.sampling.rays import Rays
    from sarmitsuba.tracing.kernel.accumulators import GridAccumulator
    from sarmitsuba.tracing.kernel.launch import LaunchGrid

# derivatives that one forward launch carries where their planes are only multiplied with the adjoint data
AT_ONCE = 8
# copies of the adjoint grids while they are made, beside the one on the device
COPIES = 4


@dataclass(frozen=True, eq=False)
class Gradient:
    """Value of a loss of a scene's raw data, and its derivatives.

    Parameters
    ----------
    names : of the values, with their units in brackets
    values : (n,) float64, those of the scene
    gradient : (n,) float64, of the loss, per unit
    loss : its value
    raw : the raw data, without receiver noise
    memory : bytes of the adjoint grids of a batch of pulses and of the gradient's numbers, also where the loss is 0 and
        none are made; 0 where all parameters take forward runs
    witnesses : by kind of parameter, error of the gradient in a central difference of plain runs, see
        :mod:`sarmitsuba.apps.fit.derivative_witness`; none of an :class:`Objective`
    """

    names: tuple[str, ...]
    values: F64
    gradient: F64
    loss: float
    raw: RawData = field(repr=False)
    memory: int
    witnesses: Mapping[str, Witness] = field(default_factory=dict)

    def __len__(self) -> int:
        """Number of values."""
        return len(self.names)


@exclusive
def gradient(
    scene: SceneLike,
    parameters: Parameters,
    loss: Loss,
    *,
    values: F64 | None = None,
    edges: bool = True,
    witness: bool = True,
) -> Gradient:
    r"""Derivatives of a loss of a scene's raw data by any number of parameters.

    With the adjoint data g of the loss, :math:`dL = \Re \sum g^* \, dm`, and the raw data's derivatives of
    :func:`sarmitsuba.jacobian`, the gradient is

    .. math:: \frac{\partial L}{\partial p_k} = \Re \sum g^* \frac{\partial m}{\partial p_k}

    without any of these: the synthesis of range profiles is linear in the echoes, so its adjoint turns g into a grid
    from which every echo reads the factor of its own derivative.

    Parameters
    ----------
    scene : as loaded, a scene file, or the name of a shipped scene
    parameters : as for :func:`sarmitsuba.jacobian`
    loss : function of the raw data, complex64 (channels, pulses, samples), that returns its value and the adjoint data
        of the same shape; such as :class:`sarmitsuba.apps.fit.losses.SquaredDifference`
    values : (n,) of the parameters at which it is taken; None: those of the scene
    edges : with the parts that the edges of moving shapes hide and show, as for :func:`sarmitsuba.jacobian`
    witness : whether the gradient of each kind of parameter is measured against a central difference: two plain runs
        each, and for moving shapes a run back without edges

    Returns
    -------
    gradient : with the value of the loss and the raw data

    Raises
    ------
    SceneError, RadarError
        As for :func:`sarmitsuba.jacobian`.
    DataError
        The loss gives no pair of a finite value and adjoint data of the same shape, or is of other channels.
    ResourceError
        The adjoint grids do not fit into memory.

    Notes
    -----
    Levels, maps of levels, shifts, heights, scales and rotations of shapes take one run back together; other parameters
    one run for every eight of them, and so do shapes where scatterers beside the surfaces (edges, wires, volumes) are
    traced. Ignores the same as :func:`sarmitsuba.jacobian`. For many steps of an optimiser,
    :class:`Objective` keeps the plan. The last bits of a gradient depend on the order in which threads end.
    """
    return Objective(scene, parameters, loss, edges=edges).at(values, witness=witness)


class Objective:
    """Loss of a scene's raw data as a function of parameters: ``objective(values)`` is the value with its gradient.

    As optimisers take it: ``scipy.optimize.minimize(objective, objective.start, jac=True)``. Launch windows, rays,
    effects and blocks of pulses are those of the scene as it is, so that the loss is a fixed function of the values.

    Optimisers stop by absolute tolerances, and a loss in watts is below them at once: give it weights of 1/W.

    Parameters
    ----------
    scene, parameters, loss, edges : as for :func:`gradient`

    Attributes
    ----------
    model : raw data as a function of the values
    edges : as given
    """

    def __init__(self, scene: SceneLike, parameters: Parameters, loss: Loss, *, edges: bool = True) -> None:
        with backend_lock():
            scene = Scene.of(scene)
            if not callable(loss):
                raise DataError(
                    f"loss: {type(loss).__name__} is no function; give one of the raw data that returns a value and "
                    "adjoint data, such as SquaredDifference"
                )
            if isinstance(loss, SquaredDifference):
                loss = loss.in_order(scene.radar.channels)
            self.model, self.loss = ForwardModel(scene, parameters_of(parameters, scene)), loss
            self.edges = edges

    @property
    def start(self) -> F64:
        """Values of the scene as it is, (n,)."""
        return self.model.start

    def __call__(self, values: F64) -> tuple[float, F64]:
        """Loss and gradient at some values."""
        found = self.at(values)
        return found.loss, found.gradient

    @exclusive
    def at(self, values: F64 | None = None, *, witness: bool = False) -> Gradient:
        """The same with the raw data; None: of the scene as it is; ``witness``: as for :func:`gradient`."""
        model = self.model
        values = model.start if values is None else model.checked(values)
        data = model.data(values)
        value, adjoint = check_loss(self.loss, data)
        found, memory = apply_transpose(model, adjoint, values, edges=self.edges)
        seen: dict[str, Witness] = {}
        if witness:

            @cache
            def product(with_edges: bool) -> F64:
                if with_edges or not (self.edges and model.moving.any()):
                    return found
                return apply_transpose(model, adjoint, values, edges=False)[0]

            seen = gradient_witnesses(model, values, data, adjoint, product, model.scene.settings.seed)
            warn_of(model.scene.name, seen)
        return Gradient(model.names, values, found, value, model.raw(data), memory, seen)


def apply_transpose(
    model: ForwardModel, adjoint: C64 | C128, values: F64 | None = None, *, edges: bool = True
) -> tuple[F64, int]:
    r"""Transpose of the Jacobian times data, :math:`\Re J^H g`, and the bytes that it took.

    Parameters
    ----------
    model : raw data as a function of n values
    adjoint : (channels, pulses, samples) complex, g
    values : (n,) at which it is taken; None: those of the scene
    edges : with the parts that moving edges hide and show

    Returns
    -------
    product, memory : (n,) float64, and the bytes of the adjoint grids and of the gradient's numbers
    """
    here = model.placed(values)
    sizes = [len(p.values(model.scene)) for p in model.parameters]
    first = np.cumsum([0, *sizes])
    out = np.zeros(int(first[-1]))
    scale = float(np.abs(adjoint).max())
    tracer = model.tracer(here)
    plan = _ReversePlan.of(model, here, tracer)
    memory = 0
    if not scale > 0.0:
        return out, _stated_bytes(model, plan.tangents) if plan.entries else memory
    unit = (adjoint.astype(np.complex128) / scale).astype(np.complex64)
    if plan.entries:
        total, memory = _run_back(model, here, plan.tangents, unit, edges)
        for number, entries in plan.entries.items():
            starts = np.cumsum([0, *(len(own) for own in entries[:-1])])
            out[first[number] : first[number + 1]] = np.add.reduceat(total[np.concatenate(entries)], starts)
    for group in _groups(model, here, [k for k in range(len(sizes)) if k not in plan.entries]):
        _, planes = model.planes(here, [model.parameters[k] for k in group], edges=edges)
        rows = np.concatenate([np.arange(first[k], first[k + 1]) for k in group])
        for row, plane in zip(rows, planes, strict=True):
            out[row] = _product(unit, plane)
    return out * scale, memory


@dataclass(frozen=True, eq=False)
class _ReversePlan:
    """Parameters that one run back serves: tables, and the numbers of the gradient that are summed for each value."""

    tangents: SlotTangents
    entries: dict[int, list[I64]]

    @staticmethod
    def of(model: ForwardModel, here: At, tracer: Tracer) -> _ReversePlan:
        """All parameters of a model whose values are displacements, levels or texels."""
        scene, traced = here.scene, here.trace_scene
        # rays alone carry slots
        rays_alone = len(tracer.sources) == 1
        shapes = MovingShapes(traced.n_faces)
        moved: dict[int, list[tuple[int, int]]] = {}
        levelled: dict[int, list[I64]] = {}
        texels: dict[int, I64] = {}
        for k, parameter in enumerate(model.parameters):
            if not parameter.direct:
                continue
            places = [shapes.add(d) for d in here.displacements(parameter) if rays_alone]
            if None not in places and places:
                moved[k] = [place for place in places if place is not None]
            levels = [np.array(sorted(numbers), dtype=np.int64) for numbers in parameter.levels(scene)]
            if levels:
                levelled[k] = levels
            own = parameter.texels(scene)
            if own:
                texels[k] = here.texels(own)
        layer = None if traced.surfaces is None else traced.surfaces.levels
        tangents, numbers = SlotTangents.of(
            shapes,
            model.run.plan.max_depth,
            len(list_with_parts(scene.materials)) if levelled else 0,
            0 if layer is None or not texels else len(layer.texels),
            rates=model.turning,
        )
        entries = {k: [numbers[s][[i]] for s, i in own] for k, own in moved.items()}
        entries |= {k: [tangents.first_material + own for own in sets] for k, sets in levelled.items()}
        entries |= {k: list(tangents.first_texel + own[:, None]) for k, own in texels.items()}
        return _ReversePlan(tangents, entries)


class AdjointBatches(BatchTracer):
    """Tracing of batches whose echoes read adjoint grids.

    Derivatives of echoes beside edges are factors of the echoes: they read the grid of amplitudes.

    Parameters
    ----------
    tracer, rays : as for the base class
    tangents : of the tracer
    total : to which echoes add
    moves : of edges, where the rays are those beside them; None: lattices

    Attributes
    ----------
    first, data : of the next batch: its first pulse, and weighted adjoint data (channels, its pulses, samples)
    memory : bytes of the largest adjoint grids so far
    """

    def __init__(
        self,
        tracer: Tracer,
        rays: Rays,
        tangents: SlotTangents,
        total: GradientSum,
        moves: OfShapes | None = None,
    ) -> None:
        super().__init__(tracer, rays, len(tracer.sampling.scene.radar.channels), 0)
        self.tangents, self.total = tangents, total
        self.edges = None if moves is None else EdgeLattices(self, moves)
        self.first, self.data, self.memory = 0, np.zeros((0, 0, 0), dtype=np.complex64), 0
        for one in {tracer, *tracer.by_frequency}:
            one.tangents = tangents

    def trace(
        self, batch: Batch, lattices: Sequence[LaunchGrid] | None = None, *, only_rays: bool = True
    ) -> Traced:
        """See the base class."""
        if self.edges is not None:
            lattices = self.edges.of(batch)
        return super().trace(batch, lattices, only_rays=only_rays)

    def accumulator(self, pulses: Pulses, share: RangeFilter | None) -> GridAccumulator:
        """See the base class."""
        wave = self.tracer.sampling.scene.radar.waveform
        own = self.data[:, pulses.plan.start - self.first : pulses.plan.stop - self.first]
        carrier = 4.0 * np.pi * wave.center_frequency / SPEED_OF_LIGHT
        by_range = partial(make_range_derivative, carrier, share)
        plain = farther = turning = None
        if self.edges is not None or self.tangents.n_materials or self.tangents.n_texels:
            plain = pulses.adjoint(own, share)
        if self.edges is None and self.tangents.n_shapes:
            farther = pulses.adjoint(own, by_range)
            if self.tangents.rates and isinstance(pulses, KeyPulse) and pulses.each > 1:
                turning = pulses.adjoint(own * pulses.plan.tau.astype(np.float32)[:, None], by_range)
        found = pulses.accumulator(1, self.amplitudes, 0, wave.wavelength, 0)
        found.adjoint = AdjointGrids(plain, farther, turning, self.total)
        self.memory = max(self.memory, found.adjoint.n_bytes)
        return found

    def finished(self, pulses: Pulses, accumulator: GridAccumulator, share: RangeFilter | None) -> C64:
        """No profiles: the echoes went to the gradient."""
        return np.zeros((self.n_layers, pulses.plan.stop - pulses.plan.start, 0), dtype=np.complex64)


def _run_back(
    model: ForwardModel, here: At, tangents: SlotTangents, adjoint: C64, edges: bool
) -> tuple[F64, int]:
    """Numbers of the gradient, and bytes of the adjoint grids and of these numbers."""
    grids, numbers = _grid_bytes(model, tangents), 8 * tangents.size * (threads() + 1)
    check_fits(
        f"{model.scene.name}: a gradient by {len(model.names)} values",
        COPIES * grids + numbers + 4 * adjoint.nbytes,
        "take fewer pulses, or shorter blocks (key_pulse_interval)",
    )
    total = GradientSum(tangents.size)
    runs = [AdjointBatches(model.tracer(here), model.rays, tangents, total)]
    if tangents.n_shapes and edges:
        beside = tangents.beside_edges()
        runs.append(AdjointBatches(model.tracer(here), model.rays, beside, total, OfShapes(tangents)))
    for batches in runs:
        _trace_back(model, batches, adjoint)
    return total.numbers(), max(batches.memory for batches in runs) + 8 * tangents.size


def _trace_back(model: ForwardModel, batches: AdjointBatches, adjoint: C64) -> None:
    """Trace all batches against adjoint data (channels, pulses, samples)."""
    for batch, pulses, share in model.weigh():
        own = adjoint[:, pulses]
        if not own.any():
            continue
        batches.first = batch.start
        batches.data = np.zeros((len(own), batch.stop - batch.start, own.shape[2]), dtype=np.complex64)
        batches.data[:, : own.shape[1]] = share * own
        batches.trace(batch)


def _grid_bytes(model: ForwardModel, tangents: SlotTangents) -> int:
    """Bytes of the largest adjoint grids, of the first, middle and last batch."""
    batches, sizes = model.batches, []
    for k in sorted({0, len(batches) // 2, len(batches) - 1}):
        pulses = _pulses(model, batches[k])
        sizes.append(8 * int(np.prod(pulses.plan.shape(model.shape[0]))))
    kinds = bool(tangents.n_materials or tangents.n_texels) + (tangents.n_shapes > 0) + tangents.rates
    return max(sizes) * kinds


def _stated_bytes(model: ForwardModel, tangents: SlotTangents) -> int:
    """Bytes of the adjoint grids and of the gradient's numbers."""
    return _grid_bytes(model, tangents) + 8 * tangents.size


def _pulses(model: ForwardModel, batch: Batch) -> Pulses:
    kind = KeyPulse if batch.together else EveryPulse
    return kind(model.sampling, batch.start, batch.stop)


def _groups(model: ForwardModel, here: At, numbers: Sequence[int]) -> Iterator[list[int]]:
    """Parameters by number, in groups of few derivatives each."""
    group: list[int] = []
    count = 0
    for k in numbers:
        n = model.needed([model.parameters[k]], here).count
        if group and count + n > AT_ONCE:
            yield group
            group, count = [], 0
        group.append(k)
        count += n
    if group:
        yield group


def _product(adjoint: C64, plane: C64) -> float:
    """Real part of the sum of conj(adjoint) plane, in float64."""
    return sum(
        float(np.vdot(a.astype(np.complex128), p.astype(np.complex128)).real)
        for own, other in zip(adjoint, plane, strict=True)
        for a, p in zip(own, other, strict=True)
    )
