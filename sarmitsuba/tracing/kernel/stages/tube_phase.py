"""Phase integral of ray tubes."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, ClassVar

from sarmitsuba.machine.backend import dr, mi
from sarmitsuba.tracing.derivatives.hooks import derivatives_of
from sarmitsuba.tracing.kernel.stage import STAGES, Stage
from sarmitsuba.tracing.kernel.tubes import polygon
from sarmitsuba.tracing.kernel.tubes.integral_rates import integral_with_rates

if TYPE_CHECKING:
    from sarmitsuba.tracing.kernel.state import Closing, Hit, Kernel, Lane, RayState, TubeFootprint


class TubeIntegral(Stage):
    r"""Phase integral over the lit share of a tube's footprint, relative to the footprint's area A.

    .. math:: \frac1A \int e^{-j \mathbf q \cdot \mathbf r}\, dA, \quad \mathbf q = k (\hat k_i - \hat k_s)

    The part of it that does not cancel comes from the facet's edges: the echo has their range and range rate.
    """

    name: ClassVar[str] = "tube_phase"

    def at_closing(
        self, kernel: Kernel, lane: Lane, ray: RayState, hit: Hit, tube: TubeFootprint, closing: Closing
    ) -> Closing:
        """Coherent return of the tube at a hit."""
        constants, s = kernel.constants, hit.to_antenna
        wave = hit.direction - s
        rates = derivatives_of(kernel).at_integral(kernel, ray, hit, tube)
        integral, *place = polygon.phase_integral(
            -constants.wavenumber * wave,
            tube.u,
            tube.v,
            tube.bounds,
            mi.Float(constants.cell),
            constants.kept_up_to,
            partial(integral_with_rates, rates) if rates else None,
        )
        place, changes = place[:2], place[2:]
        rim = tube.u * place[0] + tube.v * place[1]
        # every point of the tube has its own launch direction, whatever mirrors lie in between
        change_out = place[0] * lane.tube_rate_a + place[1] * lane.tube_rate_b
        if hit.movement is not None and ray.spread is None:
            # mirrors and facet move too; the tube's edges are mirrored like the virtual antenna
            step = ray.edge_a * place[0] + ray.edge_b * place[1]
            change_out = dr.dot(step, mi.Vector3f(closing.virtual_velocity)) * lane.inverse_start
        across = rim - s * dr.dot(rim, s)
        change_back = dr.dot(across, mi.Vector3f(closing.velocity)) / mi.Float(hit.length_back)
        return replace(
            closing,
            integral=integral,
            slant_range=closing.slant_range + mi.Float64(0.5 * dr.dot(wave, rim)),
            range_rate=closing.range_rate - mi.Float64(0.5 * (change_out + change_back)),
            point=closing.point + mi.Vector3d(rim),
            changes=tuple(changes),
        )

    def at_vanishing(self, kernel: Kernel, hit: Hit, tube: TubeFootprint) -> mi.Bool:
        """Inner tubes of a flat facet, whose sides are all common with others and left out."""
        q = (hit.to_antenna - hit.direction) * kernel.constants.wavenumber
        return tube.bounds.cancels(q, tube.u, tube.v, kernel.constants.kept_up_to)


STAGES.register(TubeIntegral())
