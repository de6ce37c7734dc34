"""The project's own errors and warnings: one line each, with where, what, value, bound and remedy."""

# characters of a message; what is longer repeats the input, and is cut in the middle so that the remedy stays
_LONGEST = 900
_CONTROL = {**dict.fromkeys(range(32), " "), **dict.fromkeys((0x7F, 0x85, 0x2028, 0x2029), " ")}


class SarmitsubaError(Exception):
    """Base of every error that a user can cause; its text is one complete line of bounded length, whatever was read."""

    def __init__(self, text: str = "") -> None:
        line = text.translate(_CONTROL)
        if len(line) > _LONGEST:
            line = f"{line[: _LONGEST - 300]} [...] {line[-290:]}"
        super().__init__(line)


class SceneError(SarmitsubaError):
    """The scene file, a mesh or a material is missing, malformed or out of bounds."""


class RadarError(SarmitsubaError):
    """The radar description is inconsistent or does not see the scene."""


class DataError(SarmitsubaError):
    """Saved raw data or an image cannot be read, or does not fit what is asked of it."""


class BackendError(SarmitsubaError):
    """No usable Dr.Jit back end (LLVM or CUDA) on this machine."""


class ResourceError(SarmitsubaError):
    """A run that does not fit into the memory of this machine."""


class ClusterError(SarmitsubaError):
    """A cluster's scheduler or workers cannot be reached, or are lost again and again."""


class OutputError(SarmitsubaError):
    """A result cannot be written (permissions, full disk)."""


class SarmitsubaWarning(UserWarning):
    """The result stands, but something about it deserves a look; one line."""


class ExtensionError(SarmitsubaError):
    """A registered entry or a user's extension module that cannot be found or used."""


__all__ = [
    "BackendError",
    "ClusterError",
    "DataError",
    "ExtensionError",
    "OutputError",
    "RadarError",
    "ResourceError",
    "SarmitsubaError",
    "SarmitsubaWarning",
    "SceneError",
]
