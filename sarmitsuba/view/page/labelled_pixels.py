"""Labels of an image for the page: a number for the colour of each pixel, and shares."""

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from sarmitsuba.core.arrays import U8
from sarmitsuba.signal.image.labels import LabelLayer, Labels

PixelLabels = Mapping[str, str | Sequence[str] | Sequence[float] | NDArray[np.generic]]

# colours of the page; further codes, the least frequent ones, share the last
MOST_NAMES = 40
_OTHERS = "others"


def labels_payload(labels: Labels) -> list[PixelLabels]:
    """Layers of codes and of shares, ready for colouring.

    Returns
    -------
    for each layer ``name``, ``description``, ``names`` of the colours, most frequent first, ``share`` of the pixels
    that have each, and ``values`` (azimuth, range) uint8, place in ``names``. A layer of shares has in addition
    ``parts`` (azimuth, range, ``part_names``) uint8, in 1/255; its colour is that of the largest, and without any it is
    ``none``
    """
    found: list[PixelLabels] = []
    for name, layer in labels.layers.items():
        if layer.codes and not layer.parts and layer.values.dtype.kind in "iu":
            found.append(_of_codes(name, layer))
        elif layer.parts and layer.unit in ("", "1") and layer.values.dtype.kind == "f":
            found.append(_of_shares(name, layer))
    return found


def _of_codes(name: str, layer: LabelLayer) -> PixelLabels:
    codes, inverse, count = np.unique(layer.values, return_inverse=True, return_counts=True)
    names = [layer.codes.get(int(code), str(code)) for code in codes]
    return _ordered(name, layer, names, inverse.reshape(layer.values.shape), count)


def _of_shares(name: str, layer: LabelLayer) -> PixelLabels:
    shares = np.clip(np.nan_to_num(layer.values.astype(np.float64)), 0.0, 1.0)
    largest = np.where(shares.max(axis=2) > 0.0, shares.argmax(axis=2) + 1, 0)
    count = np.bincount(largest.reshape(-1), minlength=len(layer.parts) + 1)
    found = _ordered(name, layer, ["none", *layer.parts], largest, count)
    quantised: U8 = np.round(255.0 * shares).astype(np.uint8)
    return {**found, "part_names": list(layer.parts), "parts": quantised}


def _ordered(
    name: str,
    layer: LabelLayer,
    names: Sequence[str],
    places: NDArray[np.integer],
    count: NDArray[np.integer],
) -> PixelLabels:
    """Names in the order of their pixels, the rare ones as one."""
    order = np.argsort(-count, kind="stable")
    order = order[count[order] > 0]
    rank = np.zeros(len(names), dtype=np.uint8)
    rank[order] = np.minimum(np.arange(len(order)), MOST_NAMES - 1)
    shown = [names[i] for i in order[:MOST_NAMES]]
    share = (count[order] / max(int(count.sum()), 1)).tolist()
    if len(order) > MOST_NAMES:
        shown[-1] = _OTHERS
        share = [*share[: MOST_NAMES - 1], sum(share[MOST_NAMES - 1 :])]
    return {
        "name": name,
        "description": layer.description,
        "names": shown,
        "share": share,
        "values": rank[places],
    }
