"""Integrator ``sar_path``: multi-bounce coherent ray tubes; ``mi.render`` returns the focused image."""

import numpy as np

from sarmitsuba.loading.plugins import describe, given_values, register
from sarmitsuba.loading.tables import INTEGRATOR
from sarmitsuba.machine.backend import mi


@register(INTEGRATOR)
class SarPath(mi.SamplingIntegrator):
    """Holds the parameters; the work is done by `sarmitsuba.simulate` and `sarmitsuba.focus`."""

    def __init__(self, props: mi.Properties) -> None:
        self.given = given_values(props, INTEGRATOR)
        super().__init__(props)

    def render(
        self,
        scene: mi.Scene,
        sensor: int | mi.Sensor = 0,
        seed: int = 0,
        spp: int = 0,
        develop: bool = True,
        evaluate: bool = True,
    ) -> mi.TensorXf:
        """Return the image (azimuth, range, 2 n_channels): real and imaginary part of every channel.

        ``seed`` is used unless it is 0, then the integrator's is; for ``spp`` see ``ray_spacing``.
        """
        import sarmitsuba
        from sarmitsuba.loading.from_mitsuba import scene_from_mitsuba

        loaded = scene_from_mitsuba(scene, sensor, self)
        image = sarmitsuba.focus(sarmitsuba.simulate(loaded, seed=int(seed) or None))
        planes = [
            plane for name in image.channels for plane in (image.total(name).real, image.total(name).imag)
        ]
        return mi.TensorXf(np.ascontiguousarray(np.stack(planes, axis=-1), dtype=np.float32))

    def to_string(self) -> str:
        """Return the parameters as text."""
        return describe(INTEGRATOR, self.given)
