"""Coherent loss of rough surfaces."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, ClassVar

from sarmitsuba.machine.backend import dr, mi
from sarmitsuba.tracing.kernel.stage import STAGES, Stage

if TYPE_CHECKING:
    from sarmitsuba.tracing.kernel.state import Closing, Hit, Kernel, Lane, RayState, TubeFootprint
    from sarmitsuba.tracing.kernel.table_rows import MaterialRow


class RoughnessLoss(Stage):
    r"""Coherent loss of a surface with normally distributed heights of rms value :math:`s`.

    .. math:: e^{-(\mathbf q \cdot \mathbf n)^2 s^2 / 2}, \quad \mathbf q = k (\hat k_i - \hat k_s),

    which for specular reflection is :math:`e^{-2 (k s \cos \theta)^2}`.

    Notes
    -----
    Ignores shadowing among the heights and correlation between the two ends of a path.

    References
    ----------
    Ament, "Toward a theory of reflection by a rough surface", Proc. IRE 41 (1953).
    """

    name: ClassVar[str] = "roughness"

    def at_mirror(self, kernel: Kernel, properties: MaterialRow, cosine: mi.Float) -> mi.Float:
        """Factor on the field reflected by a smooth surface."""
        return dr.exp(-2.0 * dr.square(kernel.constants.wavenumber * properties.rms_height * cosine))

    def at_closing(
        self, kernel: Kernel, lane: Lane, ray: RayState, hit: Hit, tube: TubeFootprint, closing: Closing
    ) -> Closing:
        """Coherent return of the tube at a hit."""
        return replace(closing, factor=closing.factor * self.closing_loss(kernel, hit))

    def closing_loss(self, kernel: Kernel, hit: Hit) -> mi.Float:
        """Factor on the coherent return."""
        across = dr.dot(hit.direction - hit.to_antenna, hit.normal)
        return dr.exp(-0.5 * dr.square(kernel.constants.wavenumber * across * hit.properties.rms_height))


STAGES.register(RoughnessLoss())
