"""Optional packages of the extra ``formats``, imported when needed."""

import importlib
from types import ModuleType

from sarmitsuba.core.errors import DataError


def formats_package(module: str, what: str) -> ModuleType:
    """Import a module of an optional package.

    Parameters
    ----------
    module : dotted name
    what : start of the error message

    Raises
    ------
    DataError
        The package is missing.
    """
    try:
        return importlib.import_module(module)
    except ImportError as error:
        package = module.partition(".")[0]
        raise DataError(
            f"{what} the package {package} ({error}); pip install 'sarmitsuba[formats]'"
        ) from error
