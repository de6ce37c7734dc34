"""One statement of an error beside the truth."""

import math
from dataclasses import dataclass

BELOW = 3.0  # dB, that a statement may lie below the truth
# dB; echoes are complex64 (-150 dB) and pulses are summed in float32: over a thousand of them rounding is -110 to -120
FLOOR = -110.0


@dataclass(frozen=True)
class Row:
    """A statement.

    Parameters
    ----------
    topic, kind : what states it
    seed, case : what was drawn
    stated, true : dB; NaN where nothing was stated
    refused : the program would not
    note : of what is to be known besides
    """

    topic: str
    kind: str
    seed: int
    case: str
    stated: float = math.nan
    true: float = math.nan
    refused: bool = False
    note: str = ""

    @property
    def excess(self) -> float:
        """True less stated, dB: positive where the statement is too small; NaN where there is none."""
        return max(self.true, FLOOR) - max(self.stated, FLOOR)

    @property
    def text(self) -> str:
        """One line."""
        return f"{self.kind} {self.seed} [{self.case}]: stated {self.stated:.1f}, true {self.true:.1f} dB {self.note}"
