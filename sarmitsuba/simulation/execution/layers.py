"""Layers of a run: one per channel, and per bounce order and ray subset where these are kept separately."""

from dataclasses import dataclass

from sarmitsuba.effects.plan import EffectsPlan
from sarmitsuba.scene.scene import Scene
from sarmitsuba.signal.raw_data import Layer
from sarmitsuba.tracing.scatterers.sources import bounces_of


@dataclass(frozen=True)
class LayerPlan:
    """Channels, bounce orders and ray subsets that a run keeps separately.

    Parameters
    ----------
    channels : polarisation channels
    orders : numbers of bounces of echoes kept separately, the last with all beyond; (0,) where all are summed
    subsets : ray subsets kept separately; (0,) for one set of all rays, and where nothing is traced
    """

    channels: tuple[str, ...]
    orders: tuple[int, ...]
    subsets: tuple[int, ...]

    @staticmethod
    def of(scene: Scene, plan: EffectsPlan) -> "LayerPlan":
        """Layers required by the settings; ``scene`` with the effects plan applied."""
        settings = scene.settings
        # scatterers beside the mesh return over the ground whatever rays do
        depth = max(
            plan.max_depth,
            plan.echo_bounces,
            bounces_of(scene, plan.flags),
        )
        return LayerPlan(
            channels=scene.radar.channels,
            orders=tuple(range(1, depth + 1)) if settings.keep_orders else (0,),
            subsets=(1, 2) if settings.keep_subsets and scene.traced else (0,),
        )

    @property
    def layers(self) -> tuple[Layer, ...]:
        """Labels of all layers: subset after subset, order after order, channel after channel."""
        return tuple(Layer(c, o, s) for s in self.subsets for o in self.orders for c in self.channels)

    @property
    def per_subset(self) -> int:
        """Number of layers of one ray subset."""
        return len(self.orders) * len(self.channels)

    @property
    def max_order(self) -> int:
        """Highest bounce order kept separately; 0 where all are summed."""
        return self.orders[-1]

    def of_subset(self, index: int) -> slice:
        """Slice of the layers of the ``index``-th subset."""
        return slice(index * self.per_subset, (index + 1) * self.per_subset)
