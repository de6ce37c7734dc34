"""Labels on the page: what is sent, and how it is coloured and named."""

import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from sarmitsuba import cli
from sarmitsuba.signal.image import ImageGrid
from sarmitsuba.signal.pixel_labels import LabelLayer, Labels
from sarmitsuba.view.page.payload import MOST_NAMES, labels_payload

Node = Callable[..., Any]


def labels_of(**layers: LabelLayer) -> Labels:
    shape = next(iter(layers.values())).values.shape
    axis = np.array([0.0, 1.0, 0.0])
    grid = ImageGrid(
        "ground",
        np.arange(shape[0], dtype=float),
        np.arange(shape[1], dtype=float),
        np.zeros(3),
        axis,
        np.roll(axis, 1),
    )
    return Labels(grid, layers)


def test_codes_and_shares_are_sent_by_their_pixels() -> None:
    rng = np.random.default_rng(3)
    codes = rng.integers(0, 70, (40, 50)).astype(np.int32)
    shares = rng.dirichlet([0.4, 0.4, 0.4], (40, 50))
    shares[0, 0] = 0.0
    shares[0, 1] = np.nan
    labels = labels_of(
        shape=LabelLayer(codes, "", "shapes", {i: f"shape {i}" for i in range(70)}),
        mechanism=LabelLayer(shares, "", "shares", parts=("direct", "double", "more")),
        height=LabelLayer(shares[..., 0], "m", "no codes and no shares"),
        place=LabelLayer(shares, "m", "no shares", parts=("x", "y", "z")),
    )
    by_code, by_share = labels_payload(labels)
    names = np.array(by_code["names"])
    assert len(names) == MOST_NAMES and names[-1] == "others"
    shown = names[by_code["values"]]
    kept = shown != "others"
    assert (shown[kept] == np.array([f"shape {i}" for i in range(70)])[codes[kept]]).all()
    for name, share in zip(names, by_code["share"], strict=True):
        assert share == pytest.approx(np.mean(shown == name))
    known = np.isfinite(shares).all(axis=2) & (shares > 0.0).any(axis=2)
    largest = np.array(["direct", "double", "more"])[np.nan_to_num(shares).argmax(axis=2)]
    assert (np.array(by_share["names"])[by_share["values"]] == np.where(known, largest, "none")).all()
    assert (
        np.abs(by_share["parts"][known] / 255.0 - shares[known]).max() <= 0.5 / 255.0 + 1e-12
    )  # tol: rounding


def test_pixels_are_named_and_coloured(in_node: Node) -> None:
    layer = {"names": ["valid", "shadow", "layover", "none", "both"], "values": [2, 0, 1, 4]}
    shares = {"names": ["a"], "values": [0, 0], "part_names": ["a", "b", "c"], "parts": [51, 204, 1, 0, 0, 0]}
    script = """
    const { colourOf, textOf } = await import("sarmitsuba/label_view.js");
    return { colours: layer.names.map((_, i) => colourOf(layer, i)), texts: [0, 1, 2, 3].map((i) => textOf(layer, i)),
      shares: [0, 1].map((i) => textOf(shares, i)) };
    """
    got = in_node(script, layer=layer, shares=shares)
    assert [colour is None for colour in got["colours"]] == [True, False, False, True, False]
    coloured = [tuple(colour) for colour in got["colours"] if colour]
    assert len(set(coloured)) == 3
    assert got["texts"] == ["layover", "valid", "shadow", "both"]
    assert got["shares"] == ["b 80 %, a 20 %", "none"]


def test_tints_keep_the_grey_of_the_image(in_node: Node) -> None:
    script = """
    const { paintTinted } = await import("sarmitsuba/image_math.js");
    const data = new Uint8ClampedArray(4 * db.length);
    const canvas = { getContext: () => ({ createImageData: () => ({ data }), putImageData: () => {} }) };
    paintTinted(canvas, db, 2, -20, 0, values, palette);
    return { pixels: [...data], size: [canvas.width, canvas.height] };
    """
    got = in_node(script, db=[0.0, -10.0, -30.0, 0.0], values=[0, 0, 1, 1], palette=[None, [200, 100, 0]])
    assert got["size"] == [2, 2]
    pixels = np.array(got["pixels"]).reshape(4, 4)
    assert pixels[0].tolist() == [255, 255, 255, 255]
    assert len(set(pixels[1][:3].tolist())) == 1 and abs(int(pixels[1][0]) - 127.5) <= 1.0
    assert pixels[2].tolist() == [90, 45, 0, 255]  # 45 % of the colour over black
    assert pixels[3].tolist() == [round(0.55 * 255 + 90), round(0.55 * 255 + 45), round(0.55 * 255), 255]


def test_the_page_of_a_labelled_run_has_its_labels(tmp_path: Path) -> None:
    arguments = [
        "render",
        "dihedral",
        "-o",
        str(tmp_path),
        "--pixels",
        "16x12",
        "--no-error-bars",
        "--no-chart",
    ]
    assert cli.main([*arguments, "--format", "hdf5", "--labels", "--page"]) == 0
    text = (tmp_path / "page.html").read_text(encoding="utf-8")
    facts = json.loads(re.search(r'id="payload">(.*?)</script>', text, re.DOTALL)[1])  # type: ignore[index]
    found = {layer["name"]: layer for layer in facts["looks"][0]["labels"]}
    assert {"layover_shadow", "shape", "shadow_of"} <= found.keys()
    stored = Labels.load(tmp_path / "labels.h5")
    shares = dict(zip(found["shape"]["names"], found["shape"]["share"], strict=True))
    codes = stored.layers["shape"].codes
    for code in np.unique(stored["shape"]):
        assert shares[codes[int(code)]] == np.mean(stored["shape"] == code)
