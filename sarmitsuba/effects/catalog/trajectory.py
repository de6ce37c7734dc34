"""Trajectory errors: deviations of the track from a straight uniform line."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from sarmitsuba.core.arrays import F64
from sarmitsuba.core.units import db_from_amplitude
from sarmitsuba.effects.context import SceneContext
from sarmitsuba.effects.effect import EFFECTS, Assessment, Decision, Effect
from sarmitsuba.effects.text import length
from sarmitsuba.radar.track import Track
from sarmitsuba.scene.scene import Scene


class Trajectory(Effect):
    """Trajectory errors; on where the track is not straight, off replaces it by the best straight uniform line."""

    name = "trajectory"
    title = "trajectory errors"
    documentation = "deviation of the track from a straight line; off: the best straight line"
    off_when = "the track is straight"
    off_means = "best straight line, also in focusing"
    rank = 130
    at_key_pulses = False

    def assess(self, context: SceneContext, decided: Mapping[str, Decision]) -> Assessment:
        """See the class."""
        tracks = [track for track in context.scene.radar.tracks if not track.is_straight]
        if not tracks:
            return Assessment(False, "straight uniform track", -np.inf)
        departure = max(
            float(np.sqrt(np.mean(np.sum((track.position - _fit(track)) ** 2, axis=1)))) for track in tracks
        )
        phase = 2.0 * context.wavenumber * departure
        return Assessment(
            True,
            f"{length(departure)} rms off a straight uniform line",
            db_from_amplitude(min(phase, 2.0)),
        )

    def without(self, scene: Scene) -> Scene:
        """Scene with the least-squares straight track, uniform in time."""
        track = scene.radar.track
        if all(one.is_straight for one in scene.radar.tracks):
            return scene
        receiver = scene.radar.receiver
        radar = replace(
            scene.radar,
            track=_straighten_track(track),
            recorded=None,
            receiver=receiver and _straighten_track(receiver),
        )
        return replace(scene, radar=radar)


def _straighten_track(track: Track) -> Track:
    position = _fit(track)
    time = np.linspace(track.time[0], track.time[-1], track.n_pulses)
    velocity = (position[-1] - position[0]) / max(float(time[-1] - time[0]), 1e-12)
    return Track(time, position, np.broadcast_to(velocity, position.shape).copy(), track.epoch)


def _fit(track: Track) -> F64:
    line = np.linspace(-1.0, 1.0, track.n_pulses)[:, None]
    mean = track.position.mean(axis=0)
    slope = (line * (track.position - mean)).sum(axis=0) / max(float(np.square(line).sum()), 1e-12)
    return np.asarray(mean + line * slope)


EFFECTS.register(Trajectory())
