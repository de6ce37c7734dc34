"""Address of a cluster: local workers, or the scheduler of remote ones."""

import re
from dataclasses import dataclass

from sarmitsuba.core.errors import ClusterError
from sarmitsuba.signal.raw.threads import n_threads

# cores of a local worker if the number of workers is not given: more workers hold more copies of the scene, fewer
# lose more work when one fails
CORES_PER_WORKER = 4
LOCAL = "local"


@dataclass(frozen=True)
class ClusterAddress:
    """Address of the workers of a cluster.

    Parameters
    ----------
    scheduler : address of a Dask scheduler, such as ``tcp://10.0.0.1:8786``; empty: this machine
    workers : processes to start on this machine; 0 with a scheduler
    """

    scheduler: str
    workers: int

    @staticmethod
    def parse(text: str) -> "ClusterAddress":
        """Read ``local``, ``local:N`` or a scheduler's address (``HOST:PORT``, ``tcp://...``, ``tls://...``).

        Raises
        ------
        ClusterError
            The text has another form, or asks for more workers than there are cores.
        """
        word, colon, number = text.partition(":")
        if word == LOCAL and not colon:
            return ClusterAddress("", max(min(2, n_threads()), n_threads() // CORES_PER_WORKER))
        if word == LOCAL:
            if not number.isdecimal() or not 1 <= int(number) <= n_threads():
                raise ClusterError(
                    f"cluster {text}: number of workers {number or '(empty)'} is outside 1 to {n_threads()}, the cores "
                    "of this machine; give local, or local:N"
                )
            return ClusterAddress("", int(number))
        if not re.fullmatch(r"(?:[a-z]+://)?[^\s/]+:\d+", text):
            raise ClusterError(
                f"cluster {text}: not the address of a Dask scheduler; give HOST:PORT as `dask scheduler` prints it, "
                "or local"
            )
        return ClusterAddress(text, 0)

    @property
    def threads(self) -> int:
        """Cores of each worker on this machine."""
        return max(1, n_threads() // max(1, self.workers))
