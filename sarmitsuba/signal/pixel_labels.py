"""Labels of an image's pixels: named layers on its grid, and the instances of shapes in it."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sarmitsuba.core.arrays import F64
from sarmitsuba.core.errors import DataError
from sarmitsuba.core.parameters import did_you_mean
from sarmitsuba.core.registry import late
from sarmitsuba.signal.image import ImageGrid


@dataclass(frozen=True, eq=False)
class LabelLayer:
    """One quantity of every pixel.

    Parameters
    ----------
    values : (azimuth, range) or (azimuth, range, parts); integers where they are codes
    unit : of the values, "" for codes, counts and shares
    description : one line
    codes : name of each value, of a layer of codes; empty for quantities
    parts : names along the last axis; empty for two axes
    """

    values: NDArray[np.generic]
    unit: str
    description: str
    codes: Mapping[int, str] = field(default_factory=dict)
    parts: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if self.values.ndim != 2 + bool(self.parts) or (
            self.parts and self.values.shape[2] != len(self.parts)
        ):
            raise DataError(
                f"label layer: values of shape {self.values.shape} do not fit {len(self.parts)} named parts"
            )


@dataclass(frozen=True, eq=False)
class LabelledInstance:
    """One shape of the scene in the image.

    Parameters
    ----------
    number : its code in layers of instances, from 1
    name, material, semantic_class : of the shape; the class is "" without a table of classes
    box : first row, first column, last row, last column, both ends included; -1 where nothing of it is seen
    oriented_box : (4, 2) row and column of the corners of the smallest rectangle about its pixels; NaN where unseen
    pixels : number of pixels that it dominates
    shadow_pixels : number of pixels in the shadow that it casts
    visible_share : share of its surface, 0 ... 1, that the antenna sees, by area
    energy_share : share of the image's energy
    """

    number: int
    name: str
    material: str
    semantic_class: str
    box: tuple[int, int, int, int]
    oriented_box: F64
    pixels: int
    shadow_pixels: int
    visible_share: float
    energy_share: float


@dataclass(frozen=True, eq=False, repr=False)
class Labels:
    """Labels of an image.

    Parameters
    ----------
    grid : of the image
    layers : by name
    instances : shapes in the image, by number
    notes : parts that the labels leave out, a line each
    """

    grid: ImageGrid
    layers: Mapping[str, LabelLayer]
    instances: tuple[LabelledInstance, ...] = ()
    notes: tuple[str, ...] = ()

    def __repr__(self) -> str:
        """Size, layers and number of instances on one line."""
        rows, columns = self.grid.shape
        return f"Labels({rows} x {columns} pixels: {', '.join(self.layers)}; {len(self.instances)} instances)"

    def save(self, path: Path | str) -> None:
        """Write to an HDF5 file, see docs/files.md."""
        late("sarmitsuba.files.labels_file", "write_labels")(self, path)

    @staticmethod
    def load(path: Path | str) -> "Labels":
        """Read from an HDF5 file.

        Raises
        ------
        DataError
            The file is missing, holds something else or is damaged: one line.
        """
        labels = late("sarmitsuba.files.labels_file", "read_labels")(path)
        assert isinstance(labels, Labels)
        return labels

    def __getitem__(self, name: str) -> NDArray[np.generic]:
        """Values of a layer."""
        if name not in self.layers:
            guess = did_you_mean(name, self.layers)
            raise DataError(f'labels: no layer "{name}"{guess}; there are {", ".join(sorted(self.layers))}')
        return self.layers[name].values
