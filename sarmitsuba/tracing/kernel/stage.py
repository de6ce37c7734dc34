"""Stages: the action of an effect in the trace kernel. The kernel calls the stages of the effects that are on.

The kernel itself (:mod:`sarmitsuba.tracing.kernel.kernel`) has the bounce, the physical-optics and diffuse returns,
and the branching at slabs. A stage modifies their results: the fields of a ray at launch, at a hit and after
reflection, the coherent return, and every echo of every source. Stages that are off are not recorded and cost nothing.
Values that a user's stage returns are checked: the kernel records only values of the same kinds as before.
"""

from __future__ import annotations

from dataclasses import fields, is_dataclass, replace
from typing import TYPE_CHECKING, ClassVar, TypeVar

from sarmitsuba.core.errors import ExtensionError, SarmitsubaError
from sarmitsuba.core.registry import Calling, Registry, checked_type, is_built_in
from sarmitsuba.effects.effect import EFFECTS
from sarmitsuba.machine.backend import dr, mi

if TYPE_CHECKING:
    from types import TracebackType

    from sarmitsuba.effects.flags import KernelFlags
    from sarmitsuba.tracing.kernel.field import ComplexVector
    from sarmitsuba.tracing.kernel.state import (
        Closing,
        Contribution,
        Hit,
        Kernel,
        Lane,
        RayState,
        TubeFootprint,
    )
    from sarmitsuba.tracing.kernel.table_rows import MaterialRow


def like(found: Value, before: Value, optional: tuple[str, ...] = ()) -> Value:
    """Result of a stage, if each part has the type and length of that part before.

    Parameters
    ----------
    found, before : dataclasses of Dr.Jit arrays, tuples and further dataclasses
    optional : attributes that may be None, before or after

    Raises
    ------
    TypeError
        A part is of another type: Dr.Jit would refuse it later, without a name.
    ValueError
        A tuple has another number of entries, or an array is neither as wide as the kernel nor one value.
    """
    checked_type(found, type(before))
    _check(found, before, "", _width(before), optional)
    return found


def as_wide(found: Value, before: object) -> Value:
    """Result of a stage, if it is one value or as wide as the kernel's values ``before``."""
    _check_width(found, "the factor", _width(before))
    return found


def _check(found: object, before: object, name: str, width: int, optional: tuple[str, ...]) -> None:
    if found is before or (name in optional and (found is None or before is None)):
        return
    if type(found) is not type(before) and (name or not isinstance(found, type(before))):
        raise TypeError(f"{name} is {type(found).__name__}, not {type(before).__name__}")
    if is_dataclass(before):
        for part in fields(before):
            inner = f"{name}.{part.name}" if name else part.name
            _check(getattr(found, part.name), getattr(before, part.name), inner, width, optional)
    elif isinstance(before, tuple) and isinstance(found, tuple):
        if len(found) != len(before):
            raise ValueError(f"{name} has {len(found)} entries, not {len(before)}")
        for i, (a, b) in enumerate(zip(found, before, strict=True)):
            _check(a, b, f"{name}[{i}]", width, optional)
    else:
        _check_width(found, name, width)


def _check_width(found: object, name: str, width: int) -> None:
    if not dr.is_array_v(found):
        return
    n = dr.width(found)
    if n not in (1, width):
        raise ValueError(
            f"{name} has {n} values; the kernel has {width} lanes: one value for each, or one for all"
        )


def _width(value: object) -> int:
    """Largest width of the Dr.Jit arrays in a value."""
    if dr.is_array_v(value):
        return int(dr.width(value))
    if is_dataclass(value):
        return max((_width(getattr(value, part.name)) for part in fields(value)), default=1)
    return max(map(_width, value), default=1) if isinstance(value, tuple) else 1


def lost_where_not_finite(finite: mi.Bool, amplitude: mi.Complex2f) -> mi.Complex2f:
    """Amplitude that is NaN where an echo has a place that is not finite: sums of power then show it."""
    nan = mi.Complex2f(dr.nan, dr.nan)
    return dr.select(finite | (dr.squared_norm(amplitude) == 0.0), amplitude, nan)


Value = TypeVar("Value")


class Stage:
    """Action of an effect in the trace kernel; a stage overrides the methods that it needs, the others change nothing.

    Attributes
    ----------
    name : of the kernel flag that switches it (``Effect.kernel_flags``)
    in_far_field : whether it acts in ``rcs``, whose antenna is in the far field (no finite distance)
    """

    name: ClassVar[str]
    in_far_field: ClassVar[bool] = True

    def at_launch(self, kernel: Kernel, lane: Lane, ray: RayState) -> RayState:
        """Ray at launch from the antenna."""
        return ray

    def at_hit(self, kernel: Kernel, lane: Lane, ray: RayState, hit: Hit) -> RayState:
        """Incident ray at a hit, before its returns are computed and it is reflected."""
        return ray

    def at_mirror(self, kernel: Kernel, properties: MaterialRow, cosine: mi.Float) -> mi.Float | None:
        """Factor on the field reflected by a smooth surface; None: one.

        Parameters
        ----------
        properties : of the material, such as ``properties.rms_height`` (m)
        cosine : of the angle of incidence
        """
        return None

    def at_closing(
        self, kernel: Kernel, lane: Lane, ray: RayState, hit: Hit, tube: TubeFootprint, closing: Closing
    ) -> Closing:
        """Coherent return of the tube at a hit, before polarisation."""
        return closing

    def closing_loss(self, kernel: Kernel, hit: Hit) -> mi.Float | None:
        """Factor of :meth:`at_closing` that depends on the material, to differentiate by its properties; None: one."""
        return None

    def at_vanishing(self, kernel: Kernel, hit: Hit, tube: TubeFootprint) -> mi.Bool | None:
        """Lanes whose coherent return :meth:`at_closing` makes zero, so that it is not computed; None: none."""
        return None

    def at_echo(self, wavenumber: mi.Float, echo: Contribution) -> Contribution:
        """Echo of any source (ideal points included), before it is summed.

        Parameters
        ----------
        wavenumber : rad/m, of the traced frequency
        echo : slant range and range rate float64, amplitudes one complex float32 for each channel
        """
        return echo


_KIND = "stage of the trace kernel"
STAGES: Registry[Stage] = Registry(_KIND, Stage, "sarmitsuba.tracing.kernel.stages")


def check_stages() -> None:
    """Refuse a stage without an effect that could switch it on.

    Raises
    ------
    ExtensionError
        No effect has a kernel flag of its name.
    """
    for stage in STAGES:
        if not any(stage.name in effect.kernel_flags for effect in EFFECTS):
            raise ExtensionError(
                f"stage {stage.name!r}: no effect has a kernel flag of this name; name it as the flag"
            )


def stages_of(flags: KernelFlags) -> tuple[Stage, ...]:
    """Stages of the effects that are on, in the order of their names."""
    on = (stage for stage in STAGES if flags.on(stage.name))
    return tuple(sorted(on, key=lambda stage: stage.name))


def own_stages(flags: KernelFlags) -> tuple[str, ...]:
    """Names of the active stages that extensions register."""
    return tuple(stage.name for stage in stages_of(flags) if not is_built_in(stage))


class KernelRecording:
    """Context in which a kernel is recorded: errors of an extension's stage come out of Dr.Jit's loops as one line.

    Parameters
    ----------
    flags : of the kernel
    """

    def __init__(self, flags: KernelFlags) -> None:
        self.flags = flags

    def __enter__(self) -> None:
        pass

    def __exit__(
        self, _: type[BaseException] | None, error: BaseException | None, __: TracebackType | None
    ) -> None:
        if not isinstance(error, RuntimeError | TypeError):
            return
        first: BaseException = error  # from which Dr.Jit's own follow
        cause: BaseException | None = error
        while cause is not None:
            if isinstance(cause, SarmitsubaError | KeyboardInterrupt):
                raise cause from None
            first, cause = cause, cause.__cause__ or cause.__context__
        own = own_stages(self.flags)
        if own:
            text = " ".join(str(first).split())
            raise ExtensionError(
                f"{_KIND} {', '.join(own)}: the kernel cannot be recorded: {text}"
            ) from error


def changes_echoes(flags: KernelFlags) -> bool:
    """Whether any active stage overrides :meth:`Stage.at_echo`."""
    return any(type(stage).at_echo is not Stage.at_echo for stage in stages_of(flags))


def _check_returned(stage: Stage, found: Value, before: Value, optional: tuple[str, ...] = ()) -> Value:
    """Result of a stage; checked for an extension's, see :func:`sarmitsuba.tracing.kernel.stage.like`."""
    return found if is_built_in(stage) else like(found, before, optional)


def apply_at_launch(kernel: Kernel, lane: Lane, ray: RayState) -> RayState:
    """Ray at launch, after all stages."""
    for stage in stages_of(kernel.flags):
        with Calling(_KIND, stage, "at_launch"):
            ray = _check_returned(stage, stage.at_launch(kernel, lane, ray), ray)
    return ray


def apply_at_hit(kernel: Kernel, lane: Lane, ray: RayState, hit: Hit) -> RayState:
    """Incident ray at a hit, after all stages."""
    for stage in stages_of(kernel.flags):
        with Calling(_KIND, stage, "at_hit"):
            ray = _check_returned(stage, stage.at_hit(kernel, lane, ray, hit), ray)
    return ray


def apply_at_mirror(
    kernel: Kernel, properties: MaterialRow, cosine: mi.Float, fields: tuple[ComplexVector, ...]
) -> tuple[ComplexVector, ...]:
    """Fields reflected by a smooth surface, after all stages; parameters as for :meth:`Stage.at_mirror`."""
    for stage in stages_of(kernel.flags):
        with Calling(_KIND, stage, "at_mirror"):
            kept = stage.at_mirror(kernel, properties, cosine)
            if kept is not None:
                if not is_built_in(stage):
                    kept = as_wide(checked_type(kept, type(cosine), float, int), (cosine, fields))
                fields = tuple((re * kept, im * kept) for re, im in fields)
    return fields


def apply_at_closing(
    kernel: Kernel, lane: Lane, ray: RayState, hit: Hit, tube: TubeFootprint, closing: Closing
) -> Closing:
    """Coherent return of the tube at a hit, after all stages."""
    for stage in stages_of(kernel.flags):
        with Calling(_KIND, stage, "at_closing"):
            found = stage.at_closing(kernel, lane, ray, hit, tube, closing)
            closing = _check_returned(stage, found, closing, ("integral",))
    return closing


def coherent_loss(kernel: Kernel, hit: Hit) -> mi.Float:
    """Factor on the coherent return that depends on the material, of all stages; see :meth:`Stage.closing_loss`."""
    found = mi.Float(1.0)
    for stage in stages_of(kernel.flags):
        with Calling(_KIND, stage, "closing_loss"):
            loss = stage.closing_loss(kernel, hit)
            if loss is not None:
                found *= checked_type(loss, mi.Float)
    return found


def vanishing(kernel: Kernel, hit: Hit, tube: TubeFootprint) -> mi.Bool:
    """Lanes whose coherent return is zero; none where an extension changes closings, which may replace the integral."""
    stages, none = stages_of(kernel.flags), mi.Bool(False)
    if any(type(s).at_closing is not Stage.at_closing and not is_built_in(s) for s in stages):
        return none
    for stage in stages:
        with Calling(_KIND, stage, "at_vanishing"):
            found = stage.at_vanishing(kernel, hit, tube)
            if found is not None:
                none |= checked_type(found, mi.Bool, bool)
    return none


def apply_at_echo(flags: KernelFlags, wavenumber: mi.Float, echo: Contribution) -> Contribution:
    """Echo after all stages."""
    for stage in stages_of(flags):
        with Calling(_KIND, stage, "at_echo"):
            echo = _check_returned(stage, stage.at_echo(wavenumber, echo), echo)
    if own_stages(flags):
        # an echo without a place would count as outside the receive window
        placed = echo.placed
        amplitudes = tuple(lost_where_not_finite(placed, a) for a in echo.amplitudes)
        echo = replace(echo, amplitudes=amplitudes)
    return echo
