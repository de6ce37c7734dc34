"""Ordinary plastics."""

from sarmitsuba.scene.materials.named_materials import MATERIALS, ConstantMaterial

MATERIALS.register(ConstantMaterial("plastic", "polyethylene and similar", 2.25 - 0.01j))
