"""Hooks of the trace kernel for derivatives by parameters: these, of a kernel without parameters, do nothing.

The kernel calls them at launch, at every hit, mirror and closing, and for every echo. The part carried along a path is
``RayState.derivative``, and the recorded part is ``Contribution.derivative``; no other part of the kernel reads either.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from sarmitsuba.tracing.derivatives.tangents import KernelDerivatives

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from sarmitsuba.machine.backend import mi
    from sarmitsuba.radar.antenna import Antenna
    from sarmitsuba.tracing.derivatives.leg_tangents import Shift
    from sarmitsuba.tracing.derivatives.tangents import Carried, EchoDerivative, PatchDerivative
    from sarmitsuba.tracing.kernel.leg import Leg
    from sarmitsuba.tracing.kernel.state import (
        Closing,
        Contribution,
        Hit,
        Kernel,
        Lane,
        LaunchPlace,
        RayState,
        Receiver,
        TubeFootprint,
        TubeReturn,
    )
    from sarmitsuba.tracing.kernel.tubes.integral_rates import Rate


class Derivatives(KernelDerivatives):
    """Derivatives that a kernel carries along its paths: none.

    Attributes
    ----------
    per_amplitude : numbers of a coherent return for each channel: its amplitude, and the derivatives of that by
        properties of materials and by turns of facets
    """

    per_amplitude: int = 1

    @property
    def displacements(self) -> Carried:
        """Displacements by which echoes are differentiated; only kernels with parameters have them."""
        raise NotImplementedError

    def at_launch(
        self, kernel: Kernel, lane: Lane, ray: RayState, place: LaunchPlace
    ) -> tuple[Lane, RayState]:
        """Lane and ray at launch from the antenna, after all stages."""
        return lane, ray

    def at_hit(self, kernel: Kernel, lane: Lane, ray: RayState, hit: Hit) -> tuple[Kernel, RayState, Hit]:
        """Kernel at a hit, incident ray before its returns are computed and it is reflected, and the hit."""
        return kernel, ray, hit

    def at_mirror(
        self,
        kernel: Kernel,
        lane: Lane,
        ray: RayState,
        hit: Hit,
        tube: TubeFootprint,
        n: mi.Vector3d,
        reflected: RayState,
    ) -> RayState:
        """Reflected ray; ``n``: float64, unit normal of the mirror, facing the incident ``ray``."""
        return reflected

    def at_integral(self, kernel: Kernel, ray: RayState, hit: Hit, tube: TubeFootprint) -> list[Rate]:
        """Changes of a tube for which its phase integral is differentiated; empty: none."""
        return []

    def at_closing(
        self, kernel: Kernel, lane: Lane, ray: RayState, hit: Hit, tube: TubeFootprint, closing: Closing
    ) -> EchoDerivative | None:
        """Derivatives of slant range and range rate of the coherent return of a tube."""
        return None

    def without_return(self) -> EchoDerivative | None:
        """The same in lanes without a return."""
        return None

    def at_coherent_echo(
        self,
        kernel: Kernel,
        lane: Lane,
        ray: RayState,
        hit: Hit,
        receive: Receiver,
        returned: TubeReturn,
        echo: Contribution,
    ) -> Contribution:
        """Coherent echo of a tube."""
        return echo

    def at_patch(
        self, kernel: Kernel, lane: Lane, ray: RayState, hit: Hit, receive: Receiver
    ) -> PatchDerivative | None:
        """Derivatives that all diffuse returns of a hit have in common."""
        return None

    def at_place(
        self,
        kernel: Kernel,
        lane: Lane,
        ray: RayState,
        hit: Hit,
        receive: Receiver,
        patch: PatchDerivative | None,
        offset: mi.Vector3f,
        active: mi.Bool,
    ) -> PatchDerivative | None:
        """The same at one scatterer, ``offset`` (m) from the triangle's vertex 0 at rest."""
        return None

    def at_scatterer(
        self,
        kernel: Kernel,
        lane: Lane,
        ray: RayState,
        hit: Hit,
        patch: PatchDerivative | None,
        weights: tuple[mi.Float, mi.Float | None],
        centre: mi.Vector3d,
        random: list[mi.Complex2f],
    ) -> tuple[EchoDerivative | None, EchoDerivative | None]:
        """Derivatives of the echoes of a diffuse scatterer: straight to the antenna, and back through the mirrors.

        Parameters
        ----------
        hit : with the material at the scatterer
        patch : of :meth:`at_patch` or :meth:`at_place`
        weights : amplitude factors of both echoes; None without paths back through the mirrors
        centre : float64, m, of the scatterer
        random : its random numbers
        """
        return None, None

    def at_echo(
        self,
        kernel: Kernel,
        antenna: Antenna,
        echo: Contribution,
        legs: tuple[Leg, Leg],
        shifts: Callable[[], Sequence[Shift | None]] | None = None,
        materials: tuple[mi.UInt32, mi.UInt32] | None = None,
    ) -> Contribution:
        """Echo of a scatterer at a known position.

        Parameters
        ----------
        legs : of the incident and of the scattered wave
        shifts : of the scatterer, by displacement; None: at rest
        materials : of both scatterers of a pair of diffuse ones; None: neither is diffuse
        """
        return echo


NO_DERIVATIVES = Derivatives()


def derivatives_of(kernel: Kernel) -> Derivatives:
    """Hooks of a kernel; without parameters they do nothing."""
    found = kernel.derivatives
    return found if isinstance(found, Derivatives) else NO_DERIVATIVES
