"""Register the Mitsuba plugins, which lie beside the package in a checkout and inside it when installed."""

import importlib
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from sarmitsuba.backend import ensure_backend
from sarmitsuba.errors import SceneError
from sarmitsuba.loader.elements import plain_value
from sarmitsuba.parameters import ParamTable

_PACKAGE = "sarmitsuba_plugins"


def plugins_dir() -> Path:
    """Return the folder of the plugins.

    Raises
    ------
    SceneError : the installation lacks it
    """
    package = Path(__file__).resolve().parents[1]
    inside, beside = package / "_plugins", package.parent / "plugins"
    folder = inside if inside.is_dir() else beside
    if not folder.is_dir():
        raise SceneError(f"{beside}: the Mitsuba plugins are missing; install the package again")
    return folder


def register_plugins() -> tuple[str, ...]:
    """Make ``sar_path``, ``sar_antenna``, ``range_film``, ``radar_material`` ... known to Mitsuba.

    Afterwards ``mi.load_file`` and ``mi.render`` take radar scenes. A back end is started and its variant set
    when none is. Plugins belong to one variant: call again after changing it. Sionna RT's names are left to
    Sionna RT where it is imported already.

    Returns
    -------
    names registered
    """
    ensure_backend()
    folder = plugins_dir()
    for name in [n for n in sys.modules if n == _PACKAGE or n.startswith(_PACKAGE + ".")]:
        del sys.modules[name]
    package = ModuleType(_PACKAGE)
    package.__path__ = [str(folder)]
    sys.modules[_PACKAGE] = package
    names = []
    for path in sorted(folder.glob("*.py")):
        module = importlib.import_module(f"{_PACKAGE}.{path.stem}")
        register: Callable[[], str] | None = getattr(module, "register", None)
        if register is None or (getattr(module, "SIONNA", False) and "sionna.rt" in sys.modules):
            continue
        names.append(register())
    return tuple(names)


def given_values(props: Any, table: ParamTable) -> dict[str, Any]:
    """Values that a Mitsuba object is created with, validated; nested objects are left out.

    Parameters
    ----------
    props : ``mi.Properties``
    table : of the plugin

    Raises
    ------
    SceneError, RadarError : one line; Mitsuba wraps it into a RuntimeError
    """
    keys = list(props.keys())
    given = {key: plain_value(props[key]) for key in keys if not key.startswith("_arg_")}
    identifier = props.id()
    where = f'{table.element} "{identifier}"' if identifier else f"{table.element} {table.plugin}"
    table.read(given, where)
    return given


def describe(table: ParamTable, given: Mapping[str, Any]) -> str:
    """Text of a plugin for ``print``: its parameters, defaults included, as Mitsuba writes its own."""
    values = {**table.defaults(), **given}
    lines = ",\n".join(f"  {name} = {_text(value)}" for name, value in values.items() if value != "")
    return f"{table.plugin}[\n{lines}\n]"


def _text(value: Any) -> str:
    return np.array2string(value) if isinstance(value, np.ndarray) else str(value)


__all__ = ["describe", "given_values", "plugins_dir", "register_plugins"]
