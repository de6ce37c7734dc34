"""Files of names and values that a user writes, in TOML or JSON."""

import importlib
from collections.abc import Mapping
from pathlib import Path
from types import ModuleType

from sarmitsuba.core.errors import DataError
from sarmitsuba.core.parameters import one_line
from sarmitsuba.machine.encoding import bound_to_64_bits, json_value
from sarmitsuba.machine.regular_files import read_text


def read_table(path: Path, what: str, most: int) -> Mapping[str, object]:
    """Names and values of a file; TOML where its suffix is ``.toml``, else JSON.

    Parameters
    ----------
    path : of the file
    what : kind of file with its article, for messages, such as ``a header``
    most : largest size, bytes

    Raises
    ------
    DataError
        One line: the file cannot be read, is too large, is not in UTF-8, or is malformed.
    """
    noun = what.partition(" ")[2]
    try:
        text = read_text(path, errors="strict", most=most)
    except UnicodeDecodeError:
        raise DataError(f"{path}: {what} is text in UTF-8, this is not") from None
    except OSError as error:
        raise DataError(f"{path}: cannot read the {noun}: {error.strerror}") from error
    try:
        if path.suffix.lower() == ".toml":
            content = _bound_number(_toml_reader(path).loads(text))
        else:
            content = json_value(text)
    except (ValueError, RecursionError) as error:  # tomllib's and json's
        raise DataError(f"{path}: cannot be read as {what}: {one_line(error, 200)}") from None
    if not isinstance(content, dict):
        raise DataError(f"{path}: {what} is a table of names and values, this is a {type(content).__name__}")
    return content


def _bound_number(value: object) -> object:
    """Value of TOML with whole numbers as those of JSON are read."""
    if isinstance(value, dict):
        return {name: _bound_number(one) for name, one in value.items()}
    if isinstance(value, list):
        return [_bound_number(one) for one in value]
    return bound_to_64_bits(value) if type(value) is int else value


def _toml_reader(path: Path) -> ModuleType:
    """Reader of TOML: Python's ``tomllib``, before 3.11 the package that it came from."""
    for name in ("tomllib", "tomli"):
        try:
            return importlib.import_module(name)
        except ModuleNotFoundError:
            continue
    raise DataError(f"{path}: before Python 3.11 TOML needs the package tomli; pip install tomli")
