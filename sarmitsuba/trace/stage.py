"""Stages: what an effect does in the trace kernel, in one place; the loop calls those of the effects that are on.

The loop itself is the bounce, the closing by physical optics and by diffuse scatterers, and the branch at slabs
(:mod:`sarmitsuba.trace.kernel`). A stage changes what these make: the fields of a ray as it starts, as it arrives at a
surface and as a surface mirrors it, the coherent closing, and every echo of every source. What is off is not recorded.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar

from sarmitsuba.registry import Registry

if TYPE_CHECKING:
    from sarmitsuba.backend import mi
    from sarmitsuba.effects.flags import KernelFlags
    from sarmitsuba.trace.field import ComplexVector
    from sarmitsuba.trace.state import Contribution, Hit, Kernel, Lane, RayState


class Stage:
    """What an effect does in the trace kernel. Every method here changes nothing: a stage has those that it needs.

    Attributes
    ----------
    name : of the kernel flag that switches it (``Effect.kernel_flags``)
    in_far_field : off leaves it out of ``rcs``, whose antenna stands at no true distance
    """

    name: ClassVar[str]
    in_far_field: ClassVar[bool] = True

    def at_launch(self, kernel: Kernel, lane: Lane, ray: RayState) -> RayState:
        """The ray as it leaves the antenna."""
        return ray

    def at_hit(self, kernel: Kernel, lane: Lane, ray: RayState, hit: Hit) -> RayState:
        """The ray as it arrives at a surface, before it closes there and is mirrored."""
        return ray

    def at_mirror(self, kernel: Kernel, properties: mi.Vector4f, cosine: mi.Float) -> mi.Float | None:
        """Factor on the field behind the mirror of a smooth surface; None: one.

        Parameters
        ----------
        properties : row of the material, see :func:`sarmitsuba.trace.scene_tables.material_rows`
        cosine : of the angle of incidence
        """
        return None

    def at_closing(self, kernel: Kernel, hit: Hit) -> mi.Float | None:
        """Factor on the coherent return of the tube at a hit; None: one."""
        return None

    def at_echo(self, wavenumber: mi.Float, echo: Contribution) -> Contribution:
        """Every echo of every source, before it is added up; those of ideal points too.

        Parameters
        ----------
        wavenumber : rad/m, of the frequency that is traced
        echo : slant range and range rate float64, amplitudes one complex float32 each channel
        """
        return echo


STAGES: Registry[Stage] = Registry("stage of the trace kernel", "sarmitsuba.trace.stages")


def stages_of(flags: KernelFlags) -> tuple[Stage, ...]:
    """Stages of the effects that are on, in the order of their names."""
    on = (stage for stage in STAGES if stage.name in flags.extra or getattr(flags, stage.name, False))
    return tuple(sorted(on, key=lambda stage: stage.name))


def changes_echoes(flags: KernelFlags) -> bool:
    """Whether some stage has its own :meth:`Stage.at_echo`."""
    return any(type(stage).at_echo is not Stage.at_echo for stage in stages_of(flags))


def launched(kernel: Kernel, lane: Lane, ray: RayState) -> RayState:
    """The ray as it leaves the antenna, by every stage."""
    for stage in stages_of(kernel.flags):
        ray = stage.at_launch(kernel, lane, ray)
    return ray


def arrived(kernel: Kernel, lane: Lane, ray: RayState, hit: Hit) -> RayState:
    """The ray as it arrives at a surface, by every stage."""
    for stage in stages_of(kernel.flags):
        ray = stage.at_hit(kernel, lane, ray, hit)
    return ray


def mirrored(
    kernel: Kernel, properties: mi.Vector4f, cosine: mi.Float, fields: tuple[ComplexVector, ...]
) -> tuple[ComplexVector, ...]:
    """Fields behind the mirror of a smooth surface, by every stage; parameters as for :meth:`Stage.at_mirror`."""
    for stage in stages_of(kernel.flags):
        kept = stage.at_mirror(kernel, properties, cosine)
        if kept is not None:
            fields = tuple((re * kept, im * kept) for re, im in fields)
    return fields


def closed(kernel: Kernel, hit: Hit, factor: mi.Float) -> mi.Float:
    """Factor of the coherent return of the tube at a hit, by every stage."""
    for stage in stages_of(kernel.flags):
        kept = stage.at_closing(kernel, hit)
        if kept is not None:
            factor = factor * kept
    return factor


def echoed(flags: KernelFlags, wavenumber: mi.Float, echo: Contribution) -> Contribution:
    """An echo as it is added up, by every stage."""
    for stage in stages_of(flags):
        echo = stage.at_echo(wavenumber, echo)
    return echo


__all__ = [
    "STAGES",
    "Stage",
    "arrived",
    "changes_echoes",
    "closed",
    "echoed",
    "launched",
    "mirrored",
    "stages_of",
]
