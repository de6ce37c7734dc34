"""Variables of a MATLAB file (version 7 or older), from anybody."""

import zlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import scipy

from sarmitsuba.core.errors import DataError
from sarmitsuba.core.parameters import one_line


def load_mat(path: Path, names: Sequence[str] | None = None) -> dict[str, Any]:
    """Variables of these names, or all.

    Raises
    ------
    DataError
        The file has another version or is damaged.
    """
    try:
        found: dict[str, Any] = scipy.io.loadmat(path, variable_names=names)
    except NotImplementedError as error:
        raise DataError(f"{path}: has MATLAB version 7.3; save it in MATLAB with -v7") from error
    except (
        ArithmeticError,
        AssertionError,
        AttributeError,
        LookupError,
        MemoryError,
        NameError,
        OSError,
        RuntimeError,
        TypeError,
        ValueError,
        zlib.error,
        scipy.io.matlab.MatReadError,
    ) as error:  # exceptions of loadmat for damaged files
        reason = one_line(error, 300)
        raise DataError(
            f"{path}: cannot be read as a MATLAB file, it may be damaged: {reason or type(error).__name__}"
        ) from error
    return found
