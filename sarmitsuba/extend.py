"""Imports of an extension: the registries, the base classes of their entries, and helpers.

``LAWS``, ``MATERIALS``, ``CANOPIES``, ``SCATTERERS``, ``EFFECTS``, ``STAGES``, ``MODES``, ``PATTERNS``, ``FOCUSERS``,
``AUTOFOCUSERS``, ``WINDOWS``, ``FORMATS``, ``SOURCES``; docs/extending.md has an example of each. Names are loaded on
first use: importing this module imports neither Mitsuba nor Dr.Jit.
"""

import importlib
from typing import Any

_HOME = {
    "AUTOFOCUSERS": "signal.focusing.autofocus",
    "Autofocuser": "signal.focusing.autofocus",
    "Assessment": "effects.effect",
    "CANOPIES": "scene.materials.vegetation.canopy",
    "Canopy": "scene.materials.vegetation.canopy",
    "ConstantMaterial": "scene.materials.named_materials",
    "DiffuseLaw": "scene.materials.diffuse_law",
    "EFFECTS": "effects.effect",
    "Effect": "effects.effect",
    "FOCUSERS": "signal.focusing.focuser",
    "FORMATS": "files.formats",
    "FileFormat": "files.formats",
    "FocusTask": "signal.focusing.focuser",
    "Focused": "signal.focusing.focuser",
    "Focuser": "signal.focusing.focuser",
    "LAWS": "scene.materials.diffuse_law",
    "MATERIALS": "scene.materials.named_materials",
    "MODES": "radar.mode",
    "NamedMaterial": "scene.materials.named_materials",
    "PATTERNS": "radar.pattern",
    "Param": "core.parameters",
    "Pattern": "radar.pattern",
    "RadarMode": "radar.mode",
    "Reflector": "tracing.scatterers.reflectors.reflector",
    "SCATTERERS": "scene.scatterers",
    "SOURCES": "loading.importing.source_format",
    "STAGES": "tracing.kernel.stage",
    "Sigma0": "scene.materials.diffuse_law",
    "SourceFormat": "loading.importing.source_format",
    "Stage": "tracing.kernel.stage",
    "WINDOWS": "signal.focusing.windows.window",
    "WindowFamily": "signal.focusing.windows.window",
    "WindowParameter": "signal.focusing.windows.window",
    "dr": "machine.backend",
    "load_extension": "core.registry",
    "mi": "machine.backend",
    "option": "signal.focusing.focuser",
}


def __getattr__(name: str) -> Any:
    """Import the home of a name on first use (PEP 562)."""
    if name not in _HOME:
        raise AttributeError(f"module 'sarmitsuba.extend' has no attribute {name!r}")
    value = globals()[name] = getattr(importlib.import_module(f"sarmitsuba.{_HOME[name]}"), name)
    return value


def __dir__() -> list[str]:
    return sorted(_HOME)
