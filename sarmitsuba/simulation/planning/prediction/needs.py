"""Rays, bytes and seconds that a run needs, by stage, and the refusal of runs that do not fit into memory."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from sarmitsuba.core.errors import ResourceError
from sarmitsuba.machine.memory import check_fits, format_bytes, held_memory
from sarmitsuba.simulation.planning.prediction.speed import Machine

# stages that report no progress of tracing
AFTER = ("chirp", "focus", "files", "labels")
# seconds and bytes per sample of a chirped echo for modulation or compression, and samples processed at a time
CHIRPED, CHIRPED_BYTES, CHIRPED_BATCH = 2.6e-8, 24, 1 << 22
# copies of the raw data held by passes, in addition to those being simulated
PASSES_HELD = 3
# seconds of labels over those of the look that they are made of, which they trace and compare again by what echoes come
# from (2 to 8 in shipped scenes); and bytes of each of its rays
LABELLED, LABEL_BYTES = 6.0, 950


@dataclass(frozen=True)
class Needs:
    """Rays, bytes and seconds that a run needs, in addition to the present memory of the process.

    Parameters
    ----------
    name : of the scene
    method : of simulation
    rays : number in the whole run
    image_shape : pixels, azimuth and range
    layers : of raw data and image
    stages : peak bytes of each stage, including data kept afterwards
    parts : bytes by kind of data
    seconds : by stage; processor seconds, of all threads, of a reference core
    key_pulses : number of pulses that are traced
    key_pulse_interval : pulses that share one tracing; 0 for methods without raw data, and where nothing is traced
    raw_bytes : of the raw data; 0 for methods without
    ray_spacing : m, of coherent rays
    kept : bytes held when the image is finished: image, raw data, and memory that the device keeps for the next launch
    n_pulses : of the raw data
    pixel_spacing : m, azimuth and range
    spent : elapsed and processor seconds on this machine before: start, loading and planning
    """

    name: str
    method: str
    rays: int
    image_shape: tuple[int, int]
    layers: int
    stages: Mapping[str, int]
    parts: Mapping[str, int]
    seconds: Mapping[str, float]
    key_pulses: int = 1
    key_pulse_interval: int = 0
    raw_bytes: int = 0
    ray_spacing: float = 0.0
    kept: int = 0
    n_pulses: int = 0
    pixel_spacing: tuple[float, float] = (1.0, 1.0)
    spent: tuple[float, float] = (0.0, 0.0)

    @property
    def bytes(self) -> int:
        """Peak bytes."""
        return max(self.stages.values())

    @property
    def pixels(self) -> int:
        """Pixels of the image, all layers."""
        return int(np.prod(self.image_shape)) * self.layers

    @property
    def pixel_pulses(self) -> int:
        """Pixels of all layers times the pulses that are focused onto them."""
        return self.pixels * self.n_pulses

    @property
    def memory(self) -> int:
        """Peak memory of the process, bytes."""
        return held_memory() + self.bytes

    @property
    def processor(self) -> dict[str, float]:
        """Processor seconds by stage on this machine, of all threads."""
        return Machine.here().processor(self.seconds)

    @property
    def elapsed(self) -> dict[str, float]:
        """Elapsed seconds by stage on this machine if idle."""
        return Machine.here().elapsed(self.seconds)

    @property
    def by_progress(self) -> dict[str, float]:
        """Elapsed seconds by the stages that report progress; the first includes all work before focusing."""
        seconds = self.elapsed
        before = sum(s for name, s in seconds.items() if name not in AFTER)
        first = {"image": "image", "raster": "raster"}.get(self.method, "trace")
        return {name: s for name, s in ((first, before), ("focus", seconds.get("focus", 0.0))) if s > 0.0}

    def then(self, stage: str, seconds: float, size: float) -> "Needs":
        """Needs with one more stage, in seconds of a reference core, and its bytes in addition to the image."""
        return replace(
            self,
            seconds={**self.seconds, stage: seconds},
            stages={**self.stages, stage: self.kept + int(size)},
        )

    def recorded(self, samples: int, chirped: int) -> "Needs":
        """Needs where the echoes are modulated with the chirp before they are written and focused.

        Parameters
        ----------
        samples, chirped : samples of a range-compressed and of a chirped echo
        """
        size = self.raw_bytes * chirped // max(samples, 1)
        more, work = size - self.raw_bytes, CHIRPED_BYTES * min(size // 8, CHIRPED_BATCH)
        stages = {name: size + (more if name == "image" else 0) for name, size in self.stages.items()}
        stages["chirp"] = self.kept + size + work
        if "image" in stages:  # compressed again, in addition to the record
            stages["image"] = max(stages["image"] + self.raw_bytes, stages["chirp"] + self.raw_bytes)
        return replace(
            self,
            seconds={
                **self.seconds,
                "chirp": size / 8 * CHIRPED,
                **({"focus": self.seconds["focus"] + size / 8 * CHIRPED} if "focus" in self.seconds else {}),
            },
            stages=stages,
            parts={name: size + (more if name == "raw data" else 0) for name, size in self.parts.items()},
            raw_bytes=size,
            kept=self.kept + more,
        )

    @property
    def without_focus(self) -> "Needs":
        """Needs without focusing."""
        kept = {name: size for name, size in self.stages.items() if name != "image"}
        seconds = {name: s for name, s in self.seconds.items() if name != "focus"}
        return replace(self, stages=kept or self.stages, seconds=seconds)

    @property
    def remedy(self) -> str:
        """Advice on a change, by the part that needs the most memory."""
        part = max(self.parts, key=lambda name: self.parts[name])
        rows, columns = self.image_shape
        metres = "check that the model is in metres (to_world)"
        remedies = {
            "rays": f"{self.rays / max(self.key_pulses, 1):.3g} rays per key pulse, {self.ray_spacing:.3g} m apart, "
            f"need the most: {metres}, make the image smaller, or set ray_spacing",
            "grids": "the grids that paths are added to need the most: make the image smaller, or leave out "
            f"keep_orders; {metres}",
            "raw data": "raw data need the most: widen azimuth_resolution, make the image smaller, or use method image",
            "sources": "wires, vegetation and pairs of diffuse scatterers need the most: make the resolution coarser, "
            "or leave some out",
            "image": f"the image of {rows} x {columns} pixels in {self.layers} layers needs the most: make its extents "
            f"smaller or its pixel spacings wider; {metres}",
        }
        return remedies[part]

    @property
    def refusal(self) -> str:
        """Reason for refusing the run, with the remedy; empty where it fits."""
        try:
            self.check()
        except ResourceError as error:
            return str(error)
        return ""

    @property
    def of_passes(self) -> "Needs":
        """Needs where passes are averaged: their mean, the change by the last one, and the step to the new mean."""
        more = PASSES_HELD * self.raw_bytes
        return replace(
            self,
            stages={name: size + more for name, size in self.stages.items()},
            kept=self.kept + more,
            parts={name: size + (more if name == "raw data" else 0) for name, size in self.parts.items()},
        )

    def check(self) -> None:
        """Raise an error if the run does not fit into memory.

        Raises
        ------
        ResourceError
            More memory is needed than there is.
        """
        check_fits(f"{self.name}: this run", self.bytes, self.remedy)

    @property
    def _before(self) -> str:
        return f", {duration(self.spent[1])} of it spent" if self.spent[1] else ""

    def labelled(self, look: "Needs") -> "Needs":
        """Needs with labels of the image; ``look``: of one look of method ``image``, whose echoes are labelled."""
        seconds = LABELLED * sum(look.seconds.values())
        return self.then("labels", seconds, look.bytes + look.rays * LABEL_BYTES)

    def __str__(self) -> str:
        """One line with rays, pixels, memory and time, of all that the command does from its start to its end."""
        rows, columns = self.image_shape
        rays = f"{self.rays / 1e6:.3g} million rays"
        if self.raw_bytes:
            rays += f" at {self.key_pulses} key pulses, {format_bytes(self.raw_bytes)} of raw data"
        threads = Machine.here().threads
        return (
            f"expected: {rays}, {rows} x {columns} pixels, {format_bytes(self.memory)} of memory, about "
            f"{duration(self.spent[0] + sum(self.elapsed.values()))} on {threads} core{'s' if threads > 1 else ''} "
            f"({duration(self.spent[1] + sum(self.processor.values()))} of processor time{self._before}); law"
        )


def duration(seconds: float) -> str:
    """Time as text with a suitable unit: ``4.1 s``, ``12 min``, ``5.2 h``."""
    if seconds < 90.0:
        return f"{seconds:.1f} s" if seconds >= 1.0 else f"{1e3 * seconds:.0f} ms"
    return f"{seconds / 60.0:.0f} min" if seconds < 5400.0 else f"{seconds / 3600.0:.1f} h"
