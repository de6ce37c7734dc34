r"""Witness of derivatives: central differences of plain runs along one drawn direction for each kind of parameter.

With the data m at some values x, a drawn step h of the values of a kind, and the derivatives J of the data,

.. math:: e = J h - \tfrac12 \left(m(x + h) - m(x - h)\right), \quad
          b = \tfrac12 \left(m(x + h) + m(x - h)\right) - m(x)

where e is the error that is stated and b is the part that the difference itself cannot tell: the bend of the data over
the step, and single rays that appear or vanish. The law is that derivatives are exact to ``EXACT_DB``, or to the energy
of b where that is more.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sarmitsuba.apps.fit.forward_model import ForwardModel
from sarmitsuba.apps.fit.material_parameters import MaterialProperty, material_of
from sarmitsuba.apps.fit.parameter import Parameter
from sarmitsuba.apps.fit.radar_parameters import BeamPointing, ClockOffset
from sarmitsuba.core.arrays import C64, C128, F64
from sarmitsuba.core.errors import SarmitsubaWarning
from sarmitsuba.core.units import db_from_amplitude
from sarmitsuba.core.witness import Witness
from sarmitsuba.scene.scene import Scene
from sarmitsuba.tracing.derivatives.tangents import Displacement

# change of the echoes over a step, first and where single rays outweigh it; an eighth of a wavelength is 1.6
NARROW, WIDE = 0.05, 0.3
# share of a difference that bend and single rays may be before the wider step is taken
BENT = 0.2
# error of derivatives that the documentation states, dB
EXACT_DB = -40.0
# rounding of float32 data over whole runs, relative to their norm; a change below it counts as much
ROUNDING = 2.0**-21
# groups of pulses from whose errors the upper level follows
GROUPS = 64
# a step to values that there are not is shortened by this, and how often
SHORTER, SHORTENED = 0.1, 2


@dataclass(frozen=True, eq=False)
class _Kind:
    """Values of one kind of parameter, such as all shifts.

    Parameters
    ----------
    name : first word of the labels
    rows : numbers of the values
    rates : (n_rows,) largest relative change of an echo with each value, 1 per unit
    moves : whether they move shapes
    """

    name: str
    rows: list[int]
    rates: list[float]
    moves: bool


@dataclass(frozen=True, eq=False)
class _Difference:
    """Half the difference of data (channels, pulses, samples) on both sides, and half their sum less those between."""

    step: F64
    change: C128
    bend: C128


def derivative_witnesses(
    model: ForwardModel, values: F64, data: C64 | C128, rows: Sequence[C64] | C64, seed: int, *, edges: bool
) -> dict[str, Witness]:
    """Witness of each kind of parameter, by its name.

    Parameters
    ----------
    model : of which these are derivatives
    values : (n,) at which
    data : (channels, pulses, samples) there
    rows : (n, channels, pulses, samples) derivatives
    seed : of the directions
    edges : whether ``rows`` hold the parts that moving edges hide and show. That is a mean over ray lattices, which
    differences
        of one lattice do not show in small steps: shapes are then differentiated once more without it.

    Notes
    -----
    Two plain runs for each kind, four where single rays outweigh the change over the first step. Ignores that an error
    may cancel along the drawn direction, and the parts that moving edges hide and show.
    """
    found = {}
    for kind in _kinds(model):
        own: Sequence[C64] = [rows[k] for k in kind.rows]
        if kind.moves and edges:
            by = [p for p in model.parameters if _kind_of(p) == kind.name]
            own = list(model.derivative(values, by=by, edges=False)[1])
        measured = _measure_difference(model, kind, values, data, seed)
        if measured is None:
            found[kind.name] = _none(kind)
            continue
        predicted: C128 = sum(
            (h * plane.astype(np.complex128) for h, plane in zip(measured.step[kind.rows], own, strict=True)),
            np.zeros(model.shape, dtype=np.complex128),
        )
        error, energy = (_sum_groups(x) for x in (predicted - measured.change, measured.change))
        rounding = ROUNDING * float(np.linalg.norm(data))
        # of a change below the rounding of the data no derivative is known
        energy = energy + max(rounding**2 - float(energy.sum()), 0.0) / len(energy)
        law = _law(measured, rounding)
        found[kind.name] = _witness(error, energy, seed, law, _reference(kind))
    return found


def gradient_witnesses(
    model: ForwardModel,
    values: F64,
    data: C64,
    adjoint: C64 | C128,
    gradient: Callable[[bool], F64],
    seed: int,
) -> dict[str, Witness]:
    """The same of a gradient, the product of derivatives with adjoint data; ``gradient``: with moving edges or without.

    Notes
    -----
    One number for each kind: its error is relative to the product with the difference of the data.
    """
    found = {}
    for kind in _kinds(model):
        measured = _measure_difference(model, kind, values, data, seed)
        if measured is None:
            found[kind.name] = _none(kind)
            continue
        predicted = float(gradient(not kind.moves)[kind.rows] @ measured.step[kind.rows])
        change, bend = (_products(adjoint, x) for x in (measured.change, measured.bend))
        rounding = ROUNDING * float(np.linalg.norm(data)) * float(np.linalg.norm(adjoint))
        unknown = float(np.abs(bend).sum()) + rounding
        whole = max(abs(float(change.sum())), rounding)
        law = max(EXACT_DB, db_from_amplitude(unknown / whole)) if whole > 0.0 else EXACT_DB
        error, energy = np.array([(predicted - change.sum()) ** 2]), np.array([whole**2])
        found[kind.name] = _witness(error, energy, seed, law, _reference(kind))
    return found


def warn_of(name: str, found: Mapping[str, Witness]) -> None:
    """Warn of every witness that contradicts its law: the kind, the measured value, the law, the remedy."""
    for kind, witness in found.items():
        if witness.contradicts:
            warnings.warn(
                f"{name}: derivatives by {kind} have an error of {witness.error_db:.0f} dB, measured here against "
                f"a difference of plain runs; a formula expected {witness.law_db:.0f} dB. Leave {kind} out, or take "
                "denser rays (ray_spacing, diffuse_ray_spacing) or shorter blocks (key_pulse_interval)",
                SarmitsubaWarning,
                stacklevel=3,
            )


def is_refuted(witness: Witness) -> bool:
    """Whether derivatives are of no use, by more than the difference itself cannot tell."""
    return witness.useless and witness.contradicts


def corner_velocities(scene: Scene, move: Displacement) -> F64:
    """Velocities (n, 3) of the antenna and of the corners of the faces that move, m per unit."""
    if move.faces is None or move.offset is None:
        return move.antenna[None]
    corners = scene.geometry.vertices[np.unique(scene.geometry.faces[move.faces])]
    moved = corners @ move.gradient.T if move.gradient is not None else np.zeros_like(corners)
    return np.asarray(np.concatenate([moved + move.offset, move.antenna[None]]))


def _kind_of(parameter: Parameter) -> str:
    return parameter.label.partition(":")[0]


def _kinds(model: ForwardModel) -> list[_Kind]:
    """Kinds of a model's parameters, in their order."""
    found: dict[str, _Kind] = {}
    moving, first = model.moving, 0
    for parameter in model.parameters:
        n, name = len(parameter.names(model.scene)), _kind_of(parameter)
        kind = found.setdefault(name, _Kind(name, [], [], bool(moving[first])))
        kind.rows.extend(range(first, first + n))
        kind.rates.extend(_rates(model, parameter, n))
        first += n
    return list(found.values())


def _rates(model: ForwardModel, parameter: Parameter, n: int) -> list[float]:
    """Largest relative change of an echo with each of n values, 1 per unit."""
    scene = model.scene
    radar = scene.radar
    moves = parameter.displacements(scene, scene.geometry.face_mesh)
    if moves:
        speed = max(float(np.linalg.norm(corner_velocities(scene, m), axis=1).max()) for m in moves)
        return [4.0 * np.pi / radar.waveform.wavelength * speed] * n
    if isinstance(parameter, MaterialProperty):
        value = float(parameter.values(scene)[0])
        scale = value or abs(material_of(scene, parameter.material, parameter.label).permittivity)
        return [1.0 / scale] * n
    if isinstance(parameter, ClockOffset):
        return [np.pi * radar.waveform.bandwidth] * n
    if isinstance(parameter, BeamPointing):
        return [width for width in radar.antenna.per_width for _ in range(n // 2)]
    return [float(np.log(10.0)) / 20.0] * n


def _measure_difference(
    model: ForwardModel, kind: _Kind, values: F64, data: C64 | C128, seed: int
) -> _Difference | None:
    """The difference along a drawn direction whose own bend is least; None: there are no values on both sides."""
    way = np.random.default_rng([seed, 0xDE51, *kind.name.encode()]).standard_normal(len(kind.rows))
    step = np.zeros(len(values))
    step[kind.rows] = NARROW * way / (np.abs(way).max() * np.array(kind.rates))
    for _ in range(SHORTENED):
        if model.possible(values + step) and model.possible(values - step):
            break
        step *= SHORTER
    else:
        return None
    found = _difference(model, values, data, step)
    wider = step * (WIDE / NARROW)
    if _bent(found) > BENT and model.possible(values + wider) and model.possible(values - wider):
        found = min(found, _difference(model, values, data, wider), key=_bent)
    return found


def _difference(model: ForwardModel, values: F64, data: C64 | C128, step: F64) -> _Difference:
    above, below = (model.data(values + sign * step).astype(np.complex128) for sign in (1.0, -1.0))
    return _Difference(step, 0.5 * (above - below), 0.5 * (above + below) - data)


def _bent(found: _Difference) -> float:
    """Bend over change."""
    change = float(np.linalg.norm(found.change))
    return float(np.linalg.norm(found.bend)) / change if change > 0.0 else 0.0


def _law(found: _Difference, rounding: float) -> float:
    """Error that derivatives may have beside the difference, dB; ``rounding``: norm of that of the data."""
    change = max(float(np.linalg.norm(found.change)), rounding)
    if not rounding > 0.0:
        return EXACT_DB
    return max(EXACT_DB, db_from_amplitude(math.hypot(_bent(found), rounding / change)))


def _witness(error: F64, energy: F64, seed: int, law: float, reference: str) -> Witness:
    if not error.any():
        return Witness(-math.inf, -math.inf, len(error), law, reference)
    return Witness.from_weighted(error, energy, seed, law_db=law, reference=reference)


def _none(kind: _Kind) -> Witness:
    return Witness(math.nan, math.nan, 0, math.nan, f"none: {kind.name} at the end of what it can be")


def _reference(kind: _Kind) -> str:
    many = f"{len(kind.rows)} values" if len(kind.rows) > 1 else "one value"
    left = ", moving edges left out" if kind.moves else ""
    return f"central difference of plain runs along a drawn direction of {many}{left}"


def _groups(n_pulses: int) -> NDArray[np.intp]:
    """Number of the group of each pulse."""
    return np.arange(n_pulses) * min(GROUPS, n_pulses) // n_pulses


def _sum_groups(data: C128) -> F64:
    """Energy of data (channels, pulses, samples) of each group of pulses."""
    power = np.sum(data.real**2 + data.imag**2, axis=(0, 2))
    return np.asarray(np.bincount(_groups(len(power)), power))


def _products(adjoint: C64 | C128, data: C128) -> F64:
    """Real parts of sums of conj(adjoint) data over each group of pulses."""
    each = np.sum((adjoint.conj() * data).real, axis=(0, 2))
    return np.asarray(np.bincount(_groups(len(each)), each))
