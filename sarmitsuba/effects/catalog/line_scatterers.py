"""Wires that scatter by a closed form: cables, rails, posts, lattice masts."""

import dataclasses
from collections.abc import Mapping

import numpy as np

from sarmitsuba.effects.context import SceneContext
from sarmitsuba.effects.effect import EFFECTS, Assessment, Decision, Effect
from sarmitsuba.effects.text import length
from sarmitsuba.scene.scene import Scene


class LineScatterers(Effect):
    """On where the scene has wires; off leaves them out."""

    name = "line_scatterers"
    title = "wires, rails and posts"
    documentation = "returns of the wires that `radar_wire` makes of cylinders and linearcurves"
    off_when = "the scene has no `radar_wire`"
    off_means = "no wire returns anything"
    rank = 136

    def assess(self, context: SceneContext, decided: Mapping[str, Decision]) -> Assessment:
        """See the class."""
        wires = context.scene.wires
        if not wires:
            return Assessment(False, "no radar_wire", -np.inf)
        wavelength = context.scene.radar.waveform.wavelength
        # that of the optics limit: what a wire returns to a radar square to it
        glint = max(2.0 * np.pi * wire.radius * wire.length**2 / wavelength for wire in wires)
        what = "1 wire" if len(wires) == 1 else f"{len(wires)} wires"
        total = sum(wire.length for wire in wires)
        why = f"{what}, {length(total)} in all, glints up to about {10.0 * np.log10(glint):.0f} dBsm"
        return Assessment(True, why, 0.0)

    def without(self, scene: Scene) -> Scene:
        """The scene without its wires."""
        return dataclasses.replace(scene, wires=())


EFFECTS.register(LineScatterers())
