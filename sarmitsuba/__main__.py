"""``python -m sarmitsuba``."""

import os
import signal
import sys
from types import FrameType

from sarmitsuba.unfinished import remove_unfinished

# signal, what is said, and the exit status by the shell's convention of 128 + its number
_ENDS = {
    signal.SIGINT: ("interrupted", 130),
    signal.SIGTERM: ("terminated", 143),
}


def main() -> int:
    """Run the command line; Ctrl-C and SIGTERM end it at once, with one line, whatever it is at.

    An exception in the middle of foreign code, which half-imported modules and callbacks of Mitsuba are, would come out
    as a traceback or a crash: the process ends without one, and what is unfinished on the disk is removed.
    """
    started = os.getpid()

    def end(number: int, frame: FrameType | None) -> None:
        for each in _ENDS:
            signal.signal(each, signal.SIG_IGN)
        said, status = _ENDS[signal.Signals(number)]
        if os.getpid() == started:  # a forked reader has no files of its own
            remove_unfinished()
            begin = "\n" if sys.stderr is not None and sys.stderr.isatty() else ""
            _say(f"{begin}error: {said}; no half-written file was left behind\n")
        os._exit(status)

    for number in _ENDS:
        if (
            signal.getsignal(number) is not signal.SIG_IGN
        ):  # as `nohup` and background jobs of a shell have it
            signal.signal(number, end)
    from sarmitsuba import cli

    status = cli.main()
    # all is written: a signal while the interpreter takes itself down would crash it
    for number in _ENDS:
        signal.signal(number, signal.SIG_IGN)
    return status


def _say(text: str) -> None:
    """Past Python's own buffers, which the interrupted code may hold."""
    try:
        os.write(2, text.encode())
    except OSError:
        return


if __name__ == "__main__":
    sys.exit(main())
