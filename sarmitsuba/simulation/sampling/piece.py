"""A piece of a scene: the middle of its image, the middle of its aperture."""

from dataclasses import replace

from sarmitsuba.radar.antenna import Pointing
from sarmitsuba.radar.radar import Radar
from sarmitsuba.scene.scene import Scene


def middle_pulses(radar: Radar, n: int) -> Radar:
    """The radar with the ``n`` pulses about the middle of its track."""
    start = (radar.track.n_pulses - n) // 2
    pick = slice(start, start + n)
    p = radar.pointing
    return replace(
        radar,
        track=radar.track.slice(start, start + n),
        recorded=radar.recorded and radar.recorded.slice(start, start + n),
        pointing=Pointing(p.boresight[pick], p.azimuth_axis[pick], p.elevation_axis[pick]),
        window=replace(radar.window, start_range=radar.window.start_range[pick]),
    )


def crop(scene: Scene, share: float, pulses: float = 1.0) -> Scene:
    """The middle of the image (``share`` of each extent), seen by the middle of the aperture (``pulses`` of it)."""
    image = replace(
        scene.image,
        extent_azimuth=scene.image.extent_azimuth * share,
        extent_range=scene.image.extent_range * share,
    )
    kept = max(2, round(scene.radar.track.n_pulses * pulses))
    return replace(scene, image=image, radar=middle_pulses(scene.radar, kept))


__all__ = ["crop", "middle_pulses"]
