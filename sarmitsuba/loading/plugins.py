"""Registration of the Mitsuba plugins, which are beside the package in a checkout and inside it when installed."""

import importlib
import os
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from types import ModuleType
from typing import TypeVar

import numpy as np

from sarmitsuba.core.errors import SceneError
from sarmitsuba.core.parameters import ParamTable
from sarmitsuba.loading.elements import Property, plain_value
from sarmitsuba.machine.backend import ensure_backend, mi
from sarmitsuba.machine.exclusive import exclusive

_PACKAGE = "sarmitsuba_plugins"
_NAME = "registered_name"  # attribute of a registered plugin class

Plugin = TypeVar("Plugin", bound="type[mi.Object]")


def plugins_dir() -> Path:
    """Return the folder of the plugins.

    Raises
    ------
    SceneError : the installation lacks it
    """
    package = Path(__file__).resolve().parents[1]
    inside, beside = package / "_plugins", package.parent / "plugins"
    folder = inside if os.path.isdir(inside) else beside
    if not os.path.isdir(folder):
        raise SceneError(f"{beside}: the Mitsuba plugins are missing; install the package again")
    return folder


@exclusive
def register_plugins() -> tuple[str, ...]:
    """Register ``sar_path``, ``sar_antenna``, ``range_film``, ``radar_material`` ... with Mitsuba.

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
    for path in sorted(folder.glob("[!_]*.py")):
        module = importlib.import_module(f"{_PACKAGE}.{path.stem}")
        classes = [
            cls for cls in (*vars(module).values(), *getattr(module, "BSDFS", ())) if isinstance(cls, type)
        ]
        names += [vars(cls)[_NAME] for cls in classes if _NAME in vars(cls)]
    return tuple(names)


def register(table: ParamTable, *, sionna: bool = False) -> Callable[[Plugin], Plugin]:
    """Class decorator that registers a plugin with Mitsuba under the name and kind of its parameter table.

    Parameters
    ----------
    table : its parameters; becomes the attribute ``table`` of the class
    sionna : not registered where Sionna RT is imported, which has one of that name
    """

    def decorate(cls: Plugin) -> Plugin:
        cls.table = table
        if not (sionna and "sionna.rt" in sys.modules):
            add = getattr(mi, f"register_{table.element}")
            add(table.plugin, lambda props: cls(props))
            setattr(cls, _NAME, table.plugin)
        return cls

    return decorate


def given_values(props: "mi.Properties", table: ParamTable) -> dict[str, Property]:
    """Validated values of a Mitsuba object's properties; nested objects under other names are left out.

    Parameters
    ----------
    props : of the object
    table : of the plugin

    Raises
    ------
    SceneError, RadarError : one line; Mitsuba wraps it into a RuntimeError
    """
    values = {key: props[key] for key in props.keys()}
    given = {
        key: plain_value(value)
        for key, value in values.items()
        if key in table.names or not isinstance(value, mi.Object)
    }
    identifier = props.id()
    where = f'{table.element} "{identifier}"' if identifier else f"{table.element} {table.plugin}"
    table.read(given, where)
    return given


def describe(table: ParamTable, given: Mapping[str, Property]) -> str:
    """Text of a plugin for ``print``: its parameters, defaults included, as Mitsuba writes plugins."""
    values = {**table.defaults(), **given}
    lines = ",\n".join(f"  {name} = {_text(value)}" for name, value in values.items() if value != "")
    return f"{table.plugin}[\n{lines}\n]"


def _text(value: object) -> str:
    return np.array2string(value) if isinstance(value, np.ndarray) else str(value)
