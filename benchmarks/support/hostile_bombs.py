"""Files that are small on the disk and large, or many, when they are read: drawn by seed in a sound outer form."""

import io
import json
import random
import struct
import zipfile
import zlib
from typing import Any

import h5py
import numpy as np

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
