"""Piece of a scene: the middle of its image and of its aperture."""

from dataclasses import replace

from sarmitsuba.radar.radar import Radar
from sarmitsuba.scene.scene import Scene


def middle_pulses(radar: Radar, n: int) -> Radar:
    """Radar with only the ``n`` pulses about the middle of its track."""
    start = (radar.track.n_pulses - n) // 2
    return radar.of_pulses(slice(start, start + n))


def crop(scene: Scene, share: float, pulses: float = 1.0) -> Scene:
    """Scene with the middle of the image (``share`` of each extent) and of the aperture (share ``pulses``)."""
    image = scene.image.scaled(share)
    kept = max(2, round(scene.radar.track.n_pulses * pulses))
    return replace(scene, image=image, radar=middle_pulses(scene.radar, kept))
