"""Errors and warnings of sarmitsuba: one line each, with place, problem, value, bound and remedy."""

# most characters of a message; longer ones repeat input, and are shortened in the middle to keep the remedy
_LONGEST = 900
# control characters, line separators, and marks of text direction
_CONTROL = dict.fromkeys(
    (*range(32), *range(0x7F, 0xA0), 0x2028, 0x2029, *range(0x202A, 0x202F), *range(0x2066, 0x206A)), " "
)


def plain_line(text: object) -> str:
    """Text for a terminal or a log: one line without control characters, of at most 900 characters."""
    line = " ".join(str(text).translate(_CONTROL).split())
    return f"{line[: _LONGEST - 300]} [...] {line[-290:]}" if len(line) > _LONGEST else line


class SarmitsubaError(Exception):
    """Base class of errors caused by the user's input or system; the text is one line of bounded length."""

    def __init__(self, text: str = "") -> None:
        super().__init__(plain_line(text))


class SceneError(SarmitsubaError):
    """The scene file, a mesh or a material is missing, malformed or out of bounds."""


class RadarError(SarmitsubaError):
    """The radar description is inconsistent or does not illuminate the scene."""


class DataError(SarmitsubaError):
    """Saved raw data or an image cannot be read, or does not match the request."""


class BackendError(SarmitsubaError):
    """No usable Dr.Jit back end (LLVM or CUDA) on this machine."""


class ResourceError(SarmitsubaError):
    """A run that does not fit into the memory of this machine."""


class ClusterError(SarmitsubaError):
    """A cluster's scheduler or workers cannot be reached, or fail repeatedly."""


class OutputError(SarmitsubaError):
    """A result cannot be written (permissions, full disk)."""


class SarmitsubaWarning(UserWarning):
    """The result is usable, but should be checked as stated; one line of bounded length."""

    def __init__(self, text: str = "") -> None:
        super().__init__(plain_line(text))


class GuessWarning(SarmitsubaWarning):
    """The physics rests on a guess, such as that of a material by its name: shown even where warnings are hidden."""


class ExtensionError(SarmitsubaError):
    """A registered entry or a user's extension module that cannot be found or used."""
