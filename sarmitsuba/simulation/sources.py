"""What returns echoes in a scene beside the surfaces that rays find."""

from sarmitsuba.effects.flags import KernelFlags
from sarmitsuba.scene.scene import Scene
from sarmitsuba.trace.source import Source


def sources_of(scene: Scene, flags: KernelFlags) -> tuple[Source, ...]:
    """Sources of a scene as the effects plan leaves it; none in most scenes.

    Parameters
    ----------
    scene : without what the plan has switched off
    flags : of the trace kernel
    """
    return ()


__all__ = ["sources_of"]
