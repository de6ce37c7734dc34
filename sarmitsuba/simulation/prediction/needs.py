"""What a run needs beyond what its process holds: rays, bytes and seconds, by stage, and what to say of it."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from sarmitsuba.errors import ResourceError
from sarmitsuba.memory import check_fits, held_memory, in_bytes
from sarmitsuba.simulation.prediction.speed import Machine

# stages that report no progress of tracing
AFTER = ("chirp", "focus", "files")
# seconds and bytes of a sample of a chirped echo while it is given its pulse or compressed, as many at a time
CHIRPED, CHIRPED_BYTES, CHIRPED_BATCH = 2.6e-8, 24, 1 << 22
# copies of the raw data that passes hold beside those that are being made
PASSES_HELD = 3


@dataclass(frozen=True)
class Needs:
    """What a run takes beyond what the process holds already.

    Parameters
    ----------
    name : of the scene
    method : of simulation
    rays : of the whole run
    image_shape : pixels, azimuth and range
    layers : of raw data and image
    stages : bytes that each stage holds at most, what outlives it included
    parts : bytes of what they consist of
    seconds : by stage; processor seconds, of all threads, of a usual core
    key_pulses : pulses that are traced
    key_pulse_interval : pulses that share one tracing; 0 for methods without raw data, and where nothing is traced
    raw_bytes : of the raw data; 0 for methods without
    ray_spacing : m, of coherent rays
    kept : bytes that are held when the image is made: it, the raw data, and what the device keeps for the next launch
    n_pulses : of the raw data
    pixel_spacing : m, azimuth and range
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

    @property
    def bytes(self) -> int:
        """Most that is held at a time."""
        return max(self.stages.values())

    @property
    def pixels(self) -> int:
        """Of the image, all layers."""
        return int(np.prod(self.image_shape)) * self.layers

    @property
    def pixel_pulses(self) -> int:
        """Pixels of all layers times the pulses that are focused onto them."""
        return self.pixels * self.n_pulses

    @property
    def memory(self) -> int:
        """Most that the process will hold at a time, bytes."""
        return held_memory() + self.bytes

    @property
    def processor(self) -> dict[str, float]:
        """Processor seconds by stage on this machine, of all threads."""
        return Machine.here().processor(self.seconds)

    @property
    def elapsed(self) -> dict[str, float]:
        """Seconds by stage on this machine, were it idle."""
        return Machine.here().elapsed(self.seconds)

    @property
    def by_progress(self) -> dict[str, float]:
        """Elapsed seconds by the stages that report progress: the first one takes what is before focusing."""
        seconds = self.elapsed
        before = sum(s for name, s in seconds.items() if name not in AFTER)
        first = {"image": "image", "raster": "raster"}.get(self.method, "trace")
        return {name: s for name, s in ((first, before), ("focus", seconds.get("focus", 0.0))) if s > 0.0}

    def then(self, stage: str, seconds: float, size: float) -> "Needs":
        """The same with another stage after the others, in seconds of a usual core, with bytes beside the image."""
        return replace(
            self,
            seconds={**self.seconds, stage: seconds},
            stages={**self.stages, stage: self.kept + int(size)},
        )

    def recorded(self, samples: int, chirped: int) -> "Needs":
        """The same where the range-compressed echoes get their pulse before they are written and focused.

        Parameters
        ----------
        samples, chirped : of a range-compressed and of a chirped echo
        """
        size = self.raw_bytes * chirped // max(samples, 1)
        more, work = size - self.raw_bytes, CHIRPED_BYTES * min(size // 8, CHIRPED_BATCH)
        stages = {name: size + (more if name == "image" else 0) for name, size in self.stages.items()}
        stages["chirp"] = self.kept + size + work
        if "image" in stages:  # compressed again, beside the record
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
        """The same where the raw data are not focused."""
        kept = {name: size for name, size in self.stages.items() if name != "image"}
        seconds = {name: s for name, s in self.seconds.items() if name != "focus"}
        return replace(self, stages=kept or self.stages, seconds=seconds)

    @property
    def remedy(self) -> str:
        """What to change, by the part that takes the most."""
        part = max(self.parts, key=lambda name: self.parts[name])
        rows, columns = self.image_shape
        metres = "check that the model is in metres (to_world)"
        remedies = {
            "rays": f"{self.rays / max(self.key_pulses, 1):.3g} rays per key pulse, {self.ray_spacing:.3g} m apart, "
            f"take the most: {metres}, make the image smaller, or set ray_spacing",
            "grids": "the grids that paths are added to take the most: make the image smaller, or leave out "
            f"keep_orders; {metres}",
            "raw data": "raw data take the most: widen azimuth_resolution, make the image smaller, or use method image",
            "sources": "wires, vegetation and pairs of diffuse scatterers take the most: make the resolution coarser, "
            "or leave some out",
            "image": f"the image of {rows} x {columns} pixels in {self.layers} layers takes the most: make its extents "
            f"smaller or its pixel spacings wider; {metres}",
        }
        return remedies[part]

    @property
    def refusal(self) -> str:
        """Why the run is refused, with the remedy; empty where it fits."""
        try:
            self.check()
        except ResourceError as error:
            return str(error)
        return ""

    @property
    def of_passes(self) -> "Needs":
        """The same where passes are added up: their mean, what the last one changed, and the step to the new mean."""
        more = PASSES_HELD * self.raw_bytes
        return replace(
            self,
            stages={name: size + more for name, size in self.stages.items()},
            kept=self.kept + more,
            parts={name: size + (more if name == "raw data" else 0) for name, size in self.parts.items()},
        )

    def check(self) -> None:
        """Refuse a run that does not fit.

        Raises
        ------
        ResourceError
            More memory is needed than there is.
        """
        check_fits(f"{self.name}: this run", self.bytes, self.remedy)

    def __str__(self) -> str:
        """One line."""
        rows, columns = self.image_shape
        rays = f"{self.rays / 1e6:.3g} million rays"
        if self.raw_bytes:
            rays += f" at {self.key_pulses} key pulses, {in_bytes(self.raw_bytes)} of raw data"
        threads = Machine.here().threads
        return (
            f"expected: {rays}, {rows} x {columns} pixels, {in_bytes(self.memory)} of memory, about "
            f"{duration(sum(self.elapsed.values()))} on {threads} core{'s' if threads > 1 else ''} "
            f"({duration(sum(self.processor.values()))} of processor time)"
        )


def duration(seconds: float) -> str:
    """A time for people: ``4.1 s``, ``12 min``, ``5.2 h``."""
    if seconds < 90.0:
        return f"{seconds:.1f} s" if seconds >= 1.0 else f"{1e3 * seconds:.0f} ms"
    return f"{seconds / 60.0:.0f} min" if seconds < 5400.0 else f"{seconds / 3600.0:.1f} h"


__all__ = ["Needs", "duration"]
