"""Wires (rails, posts, lattice masts), with the closed-form scattering of cylinders."""

import dataclasses
from collections.abc import Mapping

import numpy as np

from sarmitsuba.core.units import db_from_power
from sarmitsuba.effects.context import SceneContext
from sarmitsuba.effects.effect import EFFECTS, Assessment, Decision, Effect
from sarmitsuba.effects.text import length
from sarmitsuba.scene.scene import Scene


class LineScatterers(Effect):
    """Wires; on where the scene has any, off leaves them out."""

    name = "line_scatterers"
    title = "wires, rails and posts"
    documentation = "returns of wires: cylinders and linearcurves with a `radar_wire`"
    off_when = "the scene has no `radar_wire`"
    off_means = "no echoes of wires"
    rank = 136

    def assess(self, context: SceneContext, decided: Mapping[str, Decision]) -> Assessment:
        """See the class."""
        wires = context.scene.wires
        if not wires:
            return Assessment(False, "no radar_wire", -np.inf)
        wavelength = context.scene.radar.waveform.wavelength
        # optics limit at normal incidence
        glint = max(2.0 * np.pi * wire.radius * wire.length**2 / wavelength for wire in wires)
        what = "1 wire" if len(wires) == 1 else f"{len(wires)} wires"
        total = sum(wire.length for wire in wires)
        why = f"{what}, {length(total)} in all, glints up to about {db_from_power(glint):.0f} dBsm"
        return Assessment(True, why, 0.0)

    def without(self, scene: Scene) -> Scene:
        """Scene without its wires."""
        return dataclasses.replace(scene, wires=())


EFFECTS.register(LineScatterers())
