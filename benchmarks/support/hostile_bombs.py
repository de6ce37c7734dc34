"""Files that are small on the disk and large, or many, when they are read: drawn by seed in a sound outer form."""

import io
import json
import random
import re
import struct
import zipfile
import zlib
from typing import Any

import h5py
import numpy as np

from benchmarks.support.hostile_structure import json_tree
from sarmitsuba.machine.journal import _HEADER, _RECORD, MAGIC

LARGE = 1_700_000_000  # bytes that a bomb unpacks to: more than a case may take
_BLOCK = 1 << 24
ENCODINGS = ("koi8-r", "iso-8859-1", "utf-16", "cp1252", "us-ascii", "UTF-8", "utf-7", "shift_jis")
# what is drawn from in place of a number that counts
COUNTS = (0, 1, 3, 8, 10**4, 3 * 10**6, 2**31, 2**32 + 1, 2**62, 2**64 - 1)


def zeros(size: int, kind: int) -> bytes:
    """Deflated zeros, at least ``size`` bytes of them; the same block over and over costs one."""
    packer = zlib.compressobj(9, zlib.DEFLATED, kind)
    head = packer.compress(bytes(_BLOCK)) + packer.flush(zlib.Z_FULL_FLUSH)
    return head + (packer.compress(bytes(_BLOCK)) + packer.flush(zlib.Z_FULL_FLUSH)) * (size // _BLOCK)


def scene_graph(rng: random.Random, data: bytes) -> bytes:
    """A scene of several files, as JSON by name: includes of each other, parameters, folders, links and encodings."""
    files: dict[str, str] = json.loads(data)
    depth, width = rng.choice(((2, 3), (6, 10), (12, 10), (14, 2), (15, 1), (3, 60), (40, 1)))
    names = [f"{rng.choice(('', '', 'sub/'))}i{i}.xml" for i in range(depth)]
    body = '<bsdf type="diffuse"/>' * rng.choice((1, 1, 1, 3000))
    for i, name in enumerate(names):
        below = names[i + 1 :][:1] or rng.choice(([], [], [names[0]], ["../s.xml"], ["../outside.txt"]))
        up = "../" if name.startswith("sub/") and rng.random() < 0.5 else ""
        inner = "".join(f'<include filename="{up}{one}"/>' for one in below) * width + body
        if rng.random() < 0.2:
            inner = '<path value="sub"/>' + inner
        files[name] = f'<scene version="3.0.0">{inner}</scene>'
    more = f'<include filename="{names[0]}"/>' if rng.random() < 0.7 else ""
    if rng.random() < 0.4:
        step = "$p{0}" * rng.choice((1, 2, 10))
        values = ["haha", *(step.format(i) for i in range(rng.choice((3, 12, 40))))]
        more += "".join(f'<default name="p{i}" value="{value}"/>' for i, value in enumerate(values))
        more += f'<bsdf type="diffuse" id="$p{len(values) - 1}"/>'
    link, decoy = (
        "é.spd",
        rng.choice(("é.spd", "é".encode().decode(rng.choice(("koi8-r", "latin-1"))) + ".spd")),
    )
    if rng.random() < 0.4:
        files[decoy] = "400 1\n700 1\n"
        files[f"@link {link}"] = rng.choice(("../outside.txt", "/dev/zero", "/etc/hostname"))
        more += f'<bsdf type="diffuse"><spectrum name="reflectance" filename="{link}"/></bsdf>'
    text = files["s.xml"].replace("</scene>", more + "</scene>")
    if rng.random() < 0.4:
        text = f'<?xml version="1.0" encoding="{rng.choice(ENCODINGS)}"?>\n' + text
    return json.dumps(files | {"s.xml": text}).encode()


def serialized(rng: random.Random, data: bytes) -> bytes:
    """Flags, name, counts and length of the first mesh of a serialized file."""
    body = bytearray(zlib.decompressobj().decompress(data[4:]))
    start = body.index(b"\x00", 4) + 1
    kind = rng.choice(("count", "count", "flags", "name", "byte", "bomb", "bomb", "cut", "version"))
    head, rest = data[:4], b""
    if kind in ("count", "bomb"):
        count = rng.choice(COUNTS) if kind == "count" else LARGE // 36
        struct.pack_into("<QQ", body, start, count, rng.choice((count, 2, count // 2)))
        rest = zeros(LARGE, -15)[: -1 if rng.random() < 0.1 else None] if kind == "bomb" else b""
    elif kind == "flags":
        struct.pack_into("<I", body, 0, rng.randrange(2**16))
    elif kind == "name":
        body[4:start] = b"x" * rng.choice((0, 5000, 10**6)) + b"\x00"
    elif kind == "byte":
        body[rng.randrange(len(body))] = rng.randrange(256)
    elif kind == "cut":
        del body[rng.randrange(len(body)) :]
    else:
        head = struct.pack("<HH", rng.choice((0x041C, 0)), rng.choice((3, 5)))
    packer = zlib.compressobj()
    packed = packer.compress(bytes(body)) + packer.flush(zlib.Z_FULL_FLUSH if rest else zlib.Z_FINISH)
    return head + packed + rest + struct.pack("<QI", 0, rng.choice((1, 1, 0, 2**32 - 1)))


def openexr(rng: random.Random, data: bytes) -> bytes:
    """An OpenEXR map with other channels, types and sizes; ``data`` gives nothing but the header that it is one."""
    import tempfile
    from pathlib import Path

    import OpenEXR

    small = ((8, 1), (64, 3), (16, 900), (300, 30), (3000, 1), (1, 5000))
    size, channels = rng.choice((*small, *small, (2048, LARGE // 2**24)))
    plane = np.full(
        (size, size), rng.choice((0.0, 0.5, np.nan, np.inf, -1.0)), rng.choice((np.float32, np.float16))
    )
    names = ["R", "G", "B", "A"][:channels] if channels <= 4 else [f"c{i:04d}" for i in range(channels)]
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "m.exr"
        OpenEXR.File(header, dict.fromkeys(names, plane)).write(str(path))
        made = bytearray(path.read_bytes())
    for _ in range(rng.choice((0, 0, 1, 3))):
        made[rng.randrange(min(len(made), 600))] = rng.randrange(256)
    return bytes(made) if data[:4] == made[:4] else data


def obj(rng: random.Random, data: bytes) -> bytes:
    """Thousands of materials, objects and groups, polygons of many corners, rows that go on."""
    count = rng.choice((3, 300, 5000, 20_000))
    corners = " ".join(str(1 + i % 4) for i in range(rng.choice((3, 4, 3000))))
    rows = {
        "usemtl": "usemtl m{0}\nf 1 2 3\n",
        "both": "o o{0}\nusemtl m{0}\nf 1 2 -1\n",
        "groups": "g g{0}\nf 1 2 3\n",
        "mixed": "f 1 2 3\nf 1 2 3 4\n",
        "long": f"f {corners}\n",
        "none": "f 1 2 {0}\n",
        "rows": "f 1 \\\n2 \\\n3\n",
    }
    row = rng.choice(list(rows.values()))
    count = min(count, 3_000_000 // len(row))
    return data + b"\n" + "".join(row.format(i) for i in range(count)).encode()


def hdf5(rng: random.Random, data: bytes) -> bytes:
    """One array of an HDF5 file deflated a thousand to one, or named many times."""
    buffer = io.BytesIO(data)
    with h5py.File(buffer, "r+") as file:
        found: list[Any] = []
        file.visititems(lambda _, item: found.append(item) if isinstance(item, h5py.Dataset) else None)
        planes = [one for one in found if one.dtype.kind == "c"]
        if rng.random() < 0.2 and "layers" in file:
            names = list(file["layers"].asstr()[()]) * rng.choice((2, 20_000))
            del file["layers"]
            file["layers"] = names
            return buffer.getvalue()
        one = rng.choice(planes if planes and rng.random() < 0.7 else found)
        parent, short, dtype = one.parent, one.name.rpartition("/")[2], np.dtype(one.dtype)
        dtype = dtype if dtype.kind in "cfiu" else np.dtype("f8")
        del parent[short]
        row = _BLOCK // dtype.itemsize
        n_rows = rng.choice((1, 20, LARGE // _BLOCK + 2))
        made = parent.create_dataset(
            short, (n_rows, row), dtype, chunks=(1, row), compression=9, shuffle=rng.random() < 0.5
        )
        packed = zlib.compress(bytes(_BLOCK), 9)
        for i in range(n_rows):
            made.id.write_direct_chunk((i, 0), packed)
    return buffer.getvalue()


def npz(rng: random.Random, data: bytes) -> bytes:
    """Arrays of an .npz deflated, of another size or type, twice or beside others; its record stays."""
    with np.load(io.BytesIO(data)) as file:
        arrays = {name: file[name] for name in file.files}
    out, name = io.BytesIO(), rng.choice(("data", "data", "change", "record"))
    how = rng.choice((zipfile.ZIP_DEFLATED, zipfile.ZIP_DEFLATED, zipfile.ZIP_STORED, zipfile.ZIP_LZMA))
    n = LARGE if rng.random() < 0.1 and how == zipfile.ZIP_DEFLATED else rng.choice((0, 1000, 10**6))
    claimed = rng.choice((n, n, 2**40, -1))
    with zipfile.ZipFile(out, "w", how, compresslevel=1) as file:
        for key, value in arrays.items():
            with file.open(f"{key}.npy", "w", force_zip64=True) as member:
                if key != name:
                    np.lib.format.write_array(member, value)
                    continue
                head = {
                    "descr": value.dtype.str,
                    "fortran_order": False,
                    "shape": (claimed // value.itemsize,),
                }
                np.lib.format.write_array_header_1_0(member, head)
                for start in range(0, n, _BLOCK):
                    member.write(bytes(min(_BLOCK, n - start)))
        if rng.random() < 0.2:
            file.writestr(rng.choice(("more.npy", "../x.npy")), b"x")
    return out.getvalue()


# ---- node graphs, journals, dictionaries, coordinates ----------------------------------------------------------------


def gltf_nodes(rng: random.Random, data: bytes) -> bytes:
    """Nodes of a glTF file as chains, fans, trees, rings and shared children, with transforms of any size."""
    scene = json.loads(data)
    count = rng.choice((2, 30, 300, 999, 1500, 20_000))
    kind = rng.choice(("chain", "tree", "fan", "ring", "shared", "self", "missing", "many roots"))
    size = rng.choice((1.0, 1e-30, 1e30, 1e300, 10**400))
    nodes: list[dict[str, Any]] = [{"mesh": 0} if rng.random() < 0.5 else {} for _ in range(count)]
    for child in range(1, count):
        parent = {"chain": child - 1, "fan": 0, "tree": child // 2}.get(kind, rng.randrange(child))
        nodes[parent].setdefault("children", []).append(child)
    if kind == "ring":
        nodes[-1].setdefault("children", []).append(0)
    elif kind == "shared":
        for node in nodes[:50]:
            node.setdefault("children", []).extend(rng.randrange(count) for _ in range(3))
    elif kind == "self":
        nodes[0]["children"] = [0]
    elif kind == "missing":
        nodes[-1]["children"] = [rng.choice((-1, count, 10**30, "x", None, 1.5))]
    for _ in range(rng.choice((0, 3, 50))):
        node = rng.choice(nodes)
        node[rng.choice(("translation", "scale"))] = [size, rng.choice((size, 0, -1)), 1.0]
        if rng.random() < 0.2:
            node["matrix"] = [rng.choice((size, 0.0, 1.0, "x", None)) for _ in range(rng.choice((16, 15, 4)))]
    nodes[0]["mesh"] = 0
    scene["nodes"] = nodes
    scene["scenes"] = [{"nodes": list(range(count)) if kind == "many roots" else [0]}]
    return json.dumps(scene).encode()


def journal(rng: random.Random, data: bytes) -> bytes:
    """Records of a journal with labels and payloads drawn anew, doubled or moved, every checksum right."""
    records = []
    at = len(MAGIC)
    while at < len(data):
        _, n_label, n_payload, _ = _HEADER.unpack_from(data, at)
        start = at + _HEADER.size
        records.append((data[start : start + n_label], data[start + n_label : start + n_label + n_payload]))
        at = start + n_label + n_payload
    for _ in range(rng.choice((1, 1, 2, 4))):
        where = rng.randrange(len(records))
        label, payload = records[where]
        kind = rng.choice(
            ("label", "label", "label", "payload", "payload", "numbers", "cut", "double", "drop", "move")
        )
        if kind == "label":
            label = json_tree(rng, label)
        elif kind == "payload" and payload:
            numbers = np.frombuffer(payload, np.uint8).copy()
            bad = np.array([rng.choice((np.nan, np.inf, 1e30, -1e38))], np.float32).view(np.uint8)
            place = rng.randrange(max(len(numbers) // 4, 1)) * 4
            numbers[place : place + 4] = bad[: len(numbers[place : place + 4])]
            payload = numbers.tobytes()
        elif kind == "numbers":
            payload = np.full(
                max(len(payload) // 4, 1), rng.choice((np.nan, 1e30, 0.0)), np.float32
            ).tobytes()
        elif kind == "cut":
            payload = rng.choice((payload[:-8], payload + bytes(8), b"", payload[:-1], payload * 2))
        elif kind == "double":
            records.insert(where, (label, payload))
        elif kind == "drop" and len(records) > 1:
            del records[where]
            continue
        elif kind == "move":
            records.append(records.pop(0))
            continue
        records[where] = (label, payload)
    out = MAGIC
    for label, payload in records:
        out += (
            _HEADER.pack(_RECORD, len(label), len(payload), zlib.crc32(payload, zlib.crc32(label)))
            + label
            + payload
        )
    return out


def dictionary(rng: random.Random, data: bytes) -> bytes:
    """The seed of a dict: values of any type cannot be written to a file, and are drawn by who reads it."""
    return str(rng.randrange(2**63)).encode()


def far_outlines(rng: random.Random, data: bytes) -> bytes:
    """Footprints with coordinates of any size, in systems of any name."""
    features = json.loads(data)
    ring = features["features"][0]["geometry"]["coordinates"][0]
    size = rng.choice((1.0, 1e3, 1e5, 1e8, 1e9, 1e12, 1e19, 1e100, 1e300, 10**400))
    for corner in ring if rng.random() < 0.7 else [rng.choice(ring)]:
        for axis in rng.choice(((0,), (1,), (0, 1))):
            corner[axis] = corner[axis] * size if isinstance(size, float) else size
    codes = (
        3857,
        4326,
        25832,
        32661,
        3031,
        2154,
        27700,
        28992,
        54009,
        4978,
        4258,
        2056,
        1,
        999999,
        3395,
        5041,
        6933,
    )
    name = rng.choice(
        (
            f"EPSG:{rng.choice(codes)}",
            f"urn:ogc:def:crs:EPSG::{rng.choice(codes)}",
            f"+proj={rng.choice(('tmerc', 'merc', 'laea', 'ob_tran', 'isea', 'lcc', 'gnom', 'geos', 'pipeline'))} "
            f"+lat_0={rng.choice((0, 90, 1e9))} +a={rng.choice((6378137, 1e-300, 1e300, 0))} "
            f"+rf={rng.choice((298.25, 1e-9, 1))}",
            'LOCAL_CS["x"]',
            "x" * 3000,
        )
    )
    features["crs"] = {"type": "name", "properties": {"name": name}}
    return json.dumps(features).encode()


def far_raster(rng: random.Random, data: bytes) -> bytes:
    """An elevation raster whose pixels, corner and system are of any size; or an empty one."""
    import rasterio

    size, corner = (rng.choice((1e-300, 1e-5, 10.0, 1e6, 1e19, 1e300, 0.0, float("nan"))) for _ in range(2))
    shape = rng.choice(((24, 32), (1, 1), (1, 5), (2, 2)))
    heights = np.full(shape, rng.choice((500.0, -9999.0, float("nan"), 1e30)), np.float32)
    transform = rasterio.Affine(
        size, rng.choice((0.0, size)), corner, 0.0, -size, rng.choice((corner, 5334000.0))
    )
    system = rng.choice(("EPSG:25832", "EPSG:3857", "EPSG:4326", "EPSG:3031", "EPSG:4978", "EPSG:27700"))
    with rasterio.io.MemoryFile() as memory:
        with memory.open(
            driver="GTiff", width=shape[1], height=shape[0], count=1, dtype="float32", crs=system,
            transform=transform, nodata=-9999.0,
        ) as file:  # fmt: skip
            file.write(heights, 1)
        return bytes(memory.read())


def vectors(rng: random.Random, data: bytes) -> bytes:
    """Data sets of an HDF5 file as rows, columns, with axes of length one; integers of 400 digits in records."""
    buffer = io.BytesIO(data)
    with h5py.File(buffer, "r+") as file:
        names: list[str] = []
        file.visititems(lambda name, item: names.append(name) if isinstance(item, h5py.Dataset) else None)
        for name in rng.sample(names, min(len(names), rng.choice((1, 1, 2, 5)))):
            values = file[name][()]
            facts = dict(file[name].attrs)
            del file[name]
            if isinstance(values, bytes):
                text = values.decode()
                whole = [found for found in re.finditer(r"(?<=: )-?\d+(?=[,}])", text)]
                if whole:
                    found = rng.choice(whole)
                    text = text[: found.start()] + "9" * 400 + text[found.end() :]
                file[name] = text
            else:
                old = np.asarray(values)
                n = old.size
                shapes = (
                    *((*old.shape, 1), (1, *old.shape), (n, 1), (1, n), (1, n, 1), (n,), old.shape[::-1]),
                    (*old.shape[:1], 1, *old.shape[1:]),
                )
                file[name] = old.reshape(rng.choice(shapes))
            for key, value in facts.items():
                file[name].attrs[key] = value
    return buffer.getvalue()
