"""Damage to what files say, with their outer form kept: trees, fields, tags and arrays drawn anew."""

import io
import json
import random
import re
import struct
import sys
import xml.etree.ElementTree as ET
from collections.abc import Callable
from typing import Any

import h5py
import numpy as np

NUMBERS = (
    "0",
    "-1",
    "1",
    "nan",
    "inf",
    "-inf",
    "1e308",
    "1e-320",
    "1e18",
    "4294967296",
    "18446744073709551615",
    "2.5",
)
# what is read, opened or run where somebody takes it for a name, an address or a script
NAMES = (
    *(
        "/etc/hostname",
        "../../etc/hostname",
        "/dev/zero",
        "file:///etc/hostname",
        "../outside.txt",
        "outside.txt",
    ),
    *(
        "/vsicurl/http://127.0.0.1:9/x.tif",
        "http://127.0.0.1:9/x",
        "\\\\127.0.0.1\\x",
        "~/x",
        "$look",
        "nul",
        ".",
    ),
    *(
        "<img src=x onerror=alert(1)>",
        "</script><script>alert(1)</script>",
        "${x}$^_",
        "%n%s",
        "\u202eabc",
        "x" * 5000,
    ),
    *("", "é", " ", "abc", "a/b", "/", "1,2,3", "1 2 3", "true", "null", "HH,HV", "2020-02-30T25:61:00Z"),
)
DEEP = "@deep@"


def other(rng: random.Random, text: str) -> str:
    """Another value in place of one: a number scaled, shifted or senseless, a name, or neither."""
    try:
        value = float(text)
    except ValueError:
        words = text.split()
        if len(words) > 1 and rng.random() < 0.7:  # a list: one of its entries, or another length
            at = rng.randrange(len(words))
            if rng.random() < 0.6:
                words[at] = other(rng, words[at])
            elif rng.random() < 0.5:
                del words[at:]
            else:
                words += words[at : at + 5]
            return " ".join(words)
        return rng.choice((*NUMBERS, *NAMES, *NAMES))
    if rng.random() < 0.6:
        return repr(
            rng.choice(
                (value * 10.0 ** rng.randint(-9, 9), -value, value + rng.choice((1e-9, 1.0, -1.0, 1e6)))
            )
        )
    return rng.choice((*NUMBERS, *NUMBERS, *NAMES))


def _times(rng: random.Random) -> range:
    return range(rng.choice((1, 1, 1, 2, 3, 6)))


# ---- trees ----------------------------------------------------------------------------------------------------------


def xml_tree(rng: random.Random, data: bytes) -> bytes:
    """Values, attributes and elements of an XML file changed, doubled, moved or dropped; it stays well-formed."""
    root = ET.fromstring(data)
    for _ in _times(rng):
        elements = list(root.iter())
        parents = {child: parent for parent in elements for child in parent}
        one, two = rng.choice(elements), rng.choice(elements)
        kind = rng.choice(
            ("attribute", "attribute", "attribute", "text", "text", "drop", "double", "move", "name", "nest")
        )
        if kind == "attribute" and one.attrib:
            key = rng.choice(list(one.attrib))
            if rng.random() < 0.85:
                one.set(key, other(rng, one.attrib[key]))
            else:
                del one.attrib[key]
        elif kind == "text" and (one.text or "").strip():
            one.text = other(rng, one.text or "")
        elif kind == "drop" and one is not root:
            parents[one].remove(one)
        elif kind == "double" and one is not root and sum(1 for _ in one.iter()) * len(elements) < 20_000:
            parents[one].extend([one] * rng.choice((1, 3, 300)))
        elif kind == "move" and one is not root and one not in two.iter() and two not in one.iter():
            parents[one].remove(one)
            two.append(one)
        elif kind == "name":
            one.tag = two.tag
        elif kind == "nest" and one is not root:
            for _ in range(rng.choice((3, 60, 2000))):
                shell = ET.Element(one.tag, one.attrib)
                parents[one].remove(one)
                parents[one].append(shell)
                shell.append(one)
                parents[one] = shell
    before = sys.getrecursionlimit()
    sys.setrecursionlimit(30_000)  # Python's writer calls itself for every depth
    try:
        return ET.tostring(root, encoding="utf-8")
    finally:
        sys.setrecursionlimit(before)


def json_tree(rng: random.Random, data: bytes) -> bytes:
    """Entries of a JSON file changed, renamed, nested or dropped; it stays JSON, with Python's NaN and Infinity."""
    root = json.loads(data)
    for _ in _times(rng):
        places: list[tuple[Any, Any]] = []
        todo = [root]
        while todo:
            here = todo.pop()
            keys = list(here) if isinstance(here, dict) else range(len(here))
            places += [(here, key) for key in keys]
            todo += [here[key] for key in keys if isinstance(here[key], dict | list)]
        if not places:
            break
        where, key = rng.choice(places)
        kind = rng.choice(("value", "value", "value", "value", "type", "drop", "name", "deep", "number"))
        if kind == "value":
            old = where[key]
            text = other(rng, str(old))
            try:
                where[key] = float(text) if isinstance(old, float | int) and rng.random() < 0.8 else text
            except ValueError:
                where[key] = text
        elif kind == "number":
            where[key] = rng.choice((0, -1, 10**30, 2**63, 1.5, float("nan"), float("inf"), -1e308))
        elif kind == "type":
            where[key] = rng.choice((None, [], {}, True, [[]], {"": None}, [None] * 4, "x", 0))
        elif kind == "drop":
            del where[key]
        elif kind == "name" and isinstance(where, dict):
            where[rng.choice(NAMES)] = where.pop(key) if rng.random() < 0.5 else where[key]
        elif kind == "deep":
            where[key] = DEEP
    deep = rng.choice((200, 100_000))
    return json.dumps(root).replace(f'"{DEEP}"', "[" * deep + "]" * deep).encode("utf-8", "surrogatepass")


def within(start: bytes, end: bytes) -> Callable[[random.Random, bytes], bytes]:
    """Changes of the XML that a file holds between two marks, filled up with blanks to its size."""

    def change(rng: random.Random, data: bytes) -> bytes:
        first = data.index(start)
        last = data.index(end, first) + len(end)
        space = re.search(rb'xmlns="([^"]*)"', data[first:last])
        for _ in range(20):
            if space:
                ET.register_namespace("", space[1].decode())
            made = xml_tree(rng, data[first:last])
            if len(made) <= last - first:
                return data[:first] + made.ljust(last - first) + data[last:]
        return data

    return change


# ---- rasters --------------------------------------------------------------------------------------------------------

_SIZES = {1: 1, 2: 1, 3: 2, 4: 4, 5: 8, 6: 1, 7: 1, 8: 2, 9: 4, 10: 8, 11: 4, 12: 8}
_BIG = (0, 1, 2, 3, 7, 255, 65535, 100_000, 2**31 - 1, 2**31, 2**32 - 1)
_TAGS = (
    254,
    256,
    257,
    258,
    259,
    262,
    273,
    277,
    278,
    279,
    284,
    317,
    322,
    323,
    324,
    325,
    330,
    339,
    33550,
    33922,
    34264,
    34735,
    42112,
    42113,
)


def _within_array(rng: random.Random, made: bytearray, kind: int, start: int, number: int) -> None:
    """Change one number of a tag whose numbers stand elsewhere in the file."""
    step = _SIZES.get(kind, 1)
    place = start + step * rng.randrange(number)
    if kind == 12:
        old = struct.unpack_from("<d", made, place)[0]
        drawn = rng.choice((0.0, -old, old * 1e6, 1e308, float("nan"), float("inf"), 1e-320))
        struct.pack_into("<d", made, place, drawn)
    elif step in (2, 4):
        whole = rng.choice((*_BIG, rng.randrange(65536), 32767, 4326, 32632, 3857))
        made[place : place + step] = (whole % 256**step).to_bytes(step, "little")
    else:
        made[place] = rng.randrange(256)


def raster(rng: random.Random, data: bytes) -> bytes:
    """Tags, directories and strips of a little-endian TIFF changed; its header stays."""
    made = bytearray(data)
    (at,) = struct.unpack_from("<I", made, 4)
    (count,) = struct.unpack_from("<H", made, at)
    for _ in _times(rng):
        entry = at + 2 + 12 * rng.randrange(count)
        _, kind, number, value = struct.unpack_from("<HHII", made, entry)
        size = _SIZES.get(kind, 1) * number
        what = rng.choice(
            (
                "value",
                "value",
                "inside",
                "inside",
                "count",
                "type",
                "tag",
                "double",
                "next",
                "text",
                "samples",
            )
        )
        if what == "value":
            short = kind == 3 and number == 1
            drawn = rng.choice((*_BIG, value + 1, max(value - 1, 0), value * 2 % 2**32, at, len(made) - 1))
            struct.pack_into("<I", made, entry + 8, drawn % 65536 if short and rng.random() < 0.7 else drawn)
        elif what == "inside" and 4 < size <= len(made) - value:
            _within_array(rng, made, kind, value, number)
        elif what == "count":
            struct.pack_into("<I", made, entry + 4, rng.choice((*_BIG, number + 1, max(number - 1, 0))))
        elif what == "type":
            struct.pack_into("<H", made, entry + 2, rng.randrange(0, 20))
        elif what == "tag":
            struct.pack_into("<H", made, entry, rng.choice(_TAGS))
        elif what == "double":
            other_entry = at + 2 + 12 * rng.randrange(count)
            made[entry : entry + 12] = made[other_entry : other_entry + 12]
        elif what == "next":
            struct.pack_into("<I", made, at + 2 + 12 * count, rng.choice((at, 0, 8, len(made) - 2, at + 12)))
        elif what == "text":
            text = (
                b"<GDALMetadata><Item name='x'>"
                + rng.choice(NAMES).encode()[:200]
                + b"</Item></GDALMetadata>\x00"
            )
            struct.pack_into(
                "<HHII", made, entry, rng.choice((42112, 42113, 34737, 270)), 2, len(text), len(made)
            )
            made += text
        else:
            start = rng.randrange(8, len(made))
            made[start : start + rng.randrange(1, 40)] = rng.randbytes(rng.randrange(1, 40))
    return bytes(made)


# ---- arrays ---------------------------------------------------------------------------------------------------------


def array(rng: random.Random, old: Any) -> Any:
    """Another array in place of one: values, shape, type, or none at all."""
    old = np.asarray(old)
    kind = rng.choice(("value", "value", "all", "scale", "shape", "shape", "type", "text", "object"))
    if old.dtype.kind in "SUO":
        text = other(rng, str(old.item()) if old.size == 1 else "abc")
        return np.array([[]]) if rng.random() < 0.1 else np.array(text.encode("utf-8", "replace"))
    bad = rng.choice((0, -1, 1e300, float("nan"), float("inf"), 1e-300, 2.5))
    if kind in ("value", "all") and old.size:
        with np.errstate(all="ignore"):
            made = old.astype(old.dtype if old.dtype.kind in "fc" else np.float64, copy=True)
            made.flat[slice(None) if kind == "all" else rng.randrange(old.size)] = bad
            return made
    if kind == "scale":
        with np.errstate(all="ignore"):
            return old * rng.choice((1e-12, 1e12, -1, 0))
    if kind == "shape":
        shapes = [(0,), (), (1,), (old.size,), (1, 1, 1, old.size), (*old.shape, 2), old.shape[::-1], (3, 5)]
        return np.resize(old, rng.choice(shapes)) if old.size else np.zeros((2, 3))
    if kind == "type":
        return (
            old.real.astype(rng.choice(("i1", "u8", "f2", "f8", "c8", "?", ">f4", "S3")))
            if old.size
            else np.array("x")
        )
    return np.array(rng.choice(NAMES).encode("utf-8", "replace"))


def npz(rng: random.Random, data: bytes) -> bytes:
    """Arrays of an .npz changed, renamed or left out; its record stays JSON."""
    with np.load(io.BytesIO(data)) as file:
        arrays = {name: file[name] for name in file.files}
    for _ in _times(rng):
        name = rng.choice(list(arrays)) if arrays else "x"
        kind = rng.choice(("array", "array", "record", "record", "drop", "name", "pickle"))
        if kind == "record" and "record" in arrays and arrays["record"].dtype == np.uint8:
            try:
                arrays["record"] = np.frombuffer(json_tree(rng, arrays["record"].tobytes()), np.uint8)
            except ValueError:  # changed before
                continue
        elif kind == "array" and arrays:
            arrays[name] = array(rng, arrays[name])
        elif kind == "pickle":
            arrays[name] = np.array([{"x": 1}, None], dtype=object)
        elif kind == "name" and arrays:
            arrays[rng.choice(("x", "record", "data", "change", "../y"))] = arrays.pop(name)
        elif arrays:
            del arrays[name]
    out = io.BytesIO()
    np.savez(out, **arrays)
    return out.getvalue()


def _into(found: list[Any]) -> Callable[[str, Any], None]:
    return lambda _, item: found.append(item)


def hdf5(rng: random.Random, data: bytes) -> bytes:
    """Attributes and data sets of an HDF5 file changed, left out, or made links to elsewhere."""
    buffer = io.BytesIO(data)
    with h5py.File(buffer, "r+") as file:
        for _ in _times(rng):
            found: list[Any] = [file]
            file.visititems(_into(found))
            item = rng.choice(found)
            sets = [one for one in found if isinstance(one, h5py.Dataset)]
            kind = rng.choice(
                ("attribute", "attribute", "attribute", "data", "data", "data", "drop", "link", "huge")
            )
            if kind == "attribute" and len(item.attrs):
                key = rng.choice(list(item.attrs))
                value = item.attrs[key]
                if rng.random() < 0.15:
                    del item.attrs[key]
                elif isinstance(value, str) and value[:1] in "{[":
                    item.attrs[key] = json_tree(rng, value.encode()).decode("utf-8", "replace")[:60_000]
                elif isinstance(value, str):
                    item.attrs[key] = other(rng, value)
                else:
                    item.attrs[key] = array(rng, value)
            elif kind in ("data", "huge", "link", "drop") and sets:
                one = rng.choice(sets)
                name, old = one.name, one[()]
                parent = one.parent
                short = name.rpartition("/")[2]
                del parent[short]
                if kind == "data":
                    parent[short] = other(rng, old.decode()) if isinstance(old, bytes) else array(rng, old)
                elif kind == "huge":
                    shape = rng.choice(((2**40,), (2**20, 2**20), (2**20, 4)))
                    parent.create_dataset(
                        short, shape=shape, chunks=tuple(min(n, 4) for n in shape), dtype="c8"
                    )
                elif kind == "link":
                    targets = (
                        h5py.ExternalLink("/etc/hostname", "/"),
                        h5py.ExternalLink("outside.h5", "/x"),
                        h5py.SoftLink("/"),
                    )
                    parent[short] = rng.choice((*targets, h5py.SoftLink("/none")))
    return buffer.getvalue()


def matlab(rng: random.Random, data: bytes) -> bytes:
    """Fields of a MATLAB structure changed, renamed or left out."""
    import scipy.io

    found = scipy.io.loadmat(io.BytesIO(data))["data"][0, 0]
    fields = {name: found[name] for name in found.dtype.names}
    for _ in _times(rng):
        name = rng.choice(list(fields)) if fields else "x"
        kind = rng.choice(("array", "array", "array", "drop", "name", "cell", "nest"))
        if kind == "array" and fields:
            fields[name] = array(rng, fields[name])
        elif kind == "cell":
            fields[name] = np.array([np.zeros(2), "x"], dtype=object)
        elif kind == "nest":
            fields[name] = {"x": {"y": 1.0}}
        elif kind == "name" and fields:
            fields[rng.choice(("fp", "x", "freq", "r0", "af"))] = fields.pop(name)
        elif fields:
            del fields[name]
    out = io.BytesIO()
    scipy.io.savemat(out, {"data": fields or {"x": 0.0}}, do_compression=rng.random() < 0.3)
    return out.getvalue()
