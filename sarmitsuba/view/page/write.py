"""Assembly of one self-contained HTML file with modules, data and styles."""

import base64
import gzip
import hashlib
import json
import re
from collections.abc import Iterable, Mapping
from html import escape
from importlib.resources import files
from importlib.resources.abc import Traversable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sarmitsuba.machine.atomic import atomic_path
from sarmitsuba.view.page.payload import Value

# bare names of the vendored modules; all others are named after their file
_VENDOR_NAMES = {
    "three.module.min.js": "three",
    "three.core.min.js": "three/core",
    "OrbitControls.js": "three/orbit_controls",
    "GLTFLoader.js": "three/gltf_loader",
    "BufferGeometryUtils.js": "three/buffer_geometry",
    "SkeletonUtils.js": "three/skeleton",
}
# `from "./three.core.min.js"`: a module in a data URL has no folder
_RELATIVE = re.compile(r"""(from\s*)(["'])\.{1,2}/(?:[\w./]*/)?([\w.]+\.js)\2""")

_PART = re.compile(r"\{\{(\w+)\}\}")
# executable scripts of the page; those of other types hold data
_SCRIPT = re.compile(r'<script type="(?:importmap|module)">(.*?)</script>', re.DOTALL)
# sources that the modules create themselves: buffers read through blobs, pictures of canvases
_POLICY = (
    "default-src 'none'; style-src 'unsafe-inline'; img-src data: blob:; connect-src data: blob:; "
    "base-uri 'none'; form-action 'none'"
)

# arrays up to this number of values, such as a point, are written as JSON
_SHORT = 12


class Packer:
    """Compressed binary store of the arrays in a nested value.

    Attributes
    ----------
    blobs : base64 of the gzipped bytes, one per array
    """

    def __init__(self) -> None:
        self.blobs: list[str] = []

    def pack(self, value: Value) -> object:
        """Replace every array in a value by a reference ``{"$": number, "dtype": ..., "shape": [...]}``."""
        if isinstance(value, np.ndarray):
            # JSON has no infinity
            whole = value.dtype.kind != "f" or bool(np.isfinite(value).all())
            return value.tolist() if value.size <= _SHORT and whole else self._array(value)
        if isinstance(value, Mapping):
            return {key: self.pack(entry) for key, entry in value.items()}
        if isinstance(value, list | tuple):
            return [self.pack(entry) for entry in value]
        if isinstance(value, np.generic):
            return value.item()
        return value

    def _array(self, array: NDArray[np.generic]) -> dict[str, object]:
        plain = np.ascontiguousarray(array)
        if plain.dtype.byteorder == ">":
            plain = plain.astype(plain.dtype.newbyteorder("<"))
        # bytes of equal rank together: those of sign and exponent are similar and compress well
        planes = plain.reshape(-1).view(np.uint8).reshape(-1, plain.dtype.itemsize).T.tobytes()
        self.blobs.append(base64.b64encode(gzip.compress(planes, 6, mtime=0)).decode())
        return {"$": len(self.blobs) - 1, "dtype": plain.dtype.name, "shape": list(plain.shape)}


def write_page(path: Path, payload: Mapping[str, Value], page: str = "index.html") -> None:
    """Write the page, completely or not at all.

    Parameters
    ----------
    path : of the HTML file
    payload : of :func:`sarmitsuba.view.page.payload.page_payload`, or of the function that belongs to ``page``
    page : HTML template in ``page/web``
    """
    packer = Packer()
    facts = json.dumps(packer.pack(payload), allow_nan=False, ensure_ascii=False)
    web = files("sarmitsuba.view.page") / "web"
    blobs = "\n".join(
        f'<script type="application/octet-stream" id="blob{i}">{blob}</script>'
        for i, blob in enumerate(packer.blobs)
    )
    parts = {
        "title": escape(str(payload["title"])),
        "style": (web / "style.css").read_text(encoding="utf-8"),
        "importmap": json.dumps({"imports": _modules(web)}),
        # `</script>` inside a name would end the element
        "facts": facts.replace("<", "\\u003c"),
        "blobs": blobs,
    }
    text = (web / page).read_text(encoding="utf-8")
    own = [_PART.sub(lambda match: parts[match[1]], script) for script in _SCRIPT.findall(text)]
    parts["policy"] = _policy(own)
    text = _PART.sub(lambda match: parts[match[1]], text)
    with atomic_path(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def _policy(scripts: Iterable[str]) -> str:
    """Content security policy: no network, no inline script except those known here by hash, no event attributes.

    Modules are data URLs, which browsers do not check by hash on import.
    """
    hashes = " ".join(
        f"'sha256-{base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()}'"
        for script in scripts
    )
    return f"{_POLICY}; script-src {hashes} data:"


def _modules(web: Traversable) -> dict[str, str]:
    """Modules as data URLs by the bare name used in imports."""
    found: dict[str, str] = {}
    for folder, prefix in ((web, "sarmitsuba/"), (web / "vendor", "three/")):
        for entry in sorted(folder.iterdir(), key=lambda entry: entry.name):
            if entry.name.endswith(".js"):
                name = _VENDOR_NAMES.get(entry.name, prefix + entry.name)
                text = _RELATIVE.sub(_bare, entry.read_text(encoding="utf-8"))
                code = base64.b64encode(text.encode()).decode()
                found[name] = f"data:text/javascript;base64,{code}"
    return found


def _bare(match: re.Match[str]) -> str:
    """An import of a file beside the module, by its bare name."""
    return f'{match.group(1)}"{_VENDOR_NAMES[match.group(3)]}"'
