"""Beams of drawn radars, written as files of measured ones."""

from pathlib import Path
from typing import Any

import numpy as np


def gaussian_table(path: Path, sensor: dict[str, Any]) -> Path:
    """Write a measured beam that is a Gaussian's, and take its widths out of ``sensor``."""
    lines = ["cut, angle_deg, gain_db"]
    for cut in ("azimuth", "elevation"):
        width = sensor.pop(f"{cut}_beamwidth_deg")
        angle = np.linspace(-3.0 * width, 3.0 * width, 1201)
        gain = -10.0 * np.log10(2.0) * (np.sin(np.radians(angle)) / np.sin(np.radians(0.5 * width))) ** 2
        lines += [f"{cut}, {a:.9g}, {g:.9g}" for a, g in zip(angle, gain, strict=True)]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path
