"""``python -m sarmitsuba``."""

import gc
import os
import signal
import sys
import threading
from collections.abc import Callable
from types import FrameType

from sarmitsuba.unfinished import remove_unfinished

# new objects after which Python looks for unreachable cycles: the usual 700 takes 5 % of a short run, most of it by
# going through the libraries' modules again and again
_COLLECT_AFTER = 20_000
# signal, message, and the exit status by the shell's convention of 128 + its number
_ENDS = {
    signal.SIGINT: ("interrupted", 130),
    signal.SIGTERM: ("terminated", 143),
}


def main() -> int:
    """Run the command line; Ctrl-C and SIGTERM end it at once with one line.

    An exception in foreign code (half-imported modules, callbacks of Mitsuba) would end in a traceback or a crash: the
    process ends without one, and unfinished files are removed.
    """
    started, ending = os.getpid(), threading.RLock()

    def end(number: int, frame: FrameType | None) -> None:
        # handler and watching thread may both receive a signal: the second waits for the end of the process
        ending.acquire()
        if threading.current_thread() is threading.main_thread():
            for each in _ENDS:
                signal.signal(each, signal.SIG_IGN)
        said, status = _ENDS[signal.Signals(number)]
        if os.getpid() == started:  # a forked reader process owns no unfinished files
            remove_unfinished()
            begin = "\n" if sys.stderr is not None and sys.stderr.isatty() else ""
            _say(f"{begin}error: {said}; no half-written file was left behind\n")
        os._exit(status)

    for number in _ENDS:
        if (
            signal.getsignal(number) is not signal.SIG_IGN
        ):  # as `nohup` and background jobs of a shell have it
            signal.signal(number, end)
    _watch(end)
    gc.set_threshold(_COLLECT_AFTER)
    from sarmitsuba import cli

    status = cli.main()
    # all is written: a signal during the interpreter's shutdown would crash it
    for number in _ENDS:
        signal.signal(number, signal.SIG_IGN)
    signal.set_wakeup_fd(-1)
    return status


def _watch(end: Callable[[int, FrameType | None], None]) -> None:
    """Handle a signal while the main thread is in a long kernel, where Python calls no handler."""
    read, write = os.pipe()
    os.set_blocking(write, False)
    signal.set_wakeup_fd(write, warn_on_full_buffer=False)
    started = os.getpid()

    def wait() -> None:
        for byte in iter(lambda: os.read(read, 1), b""):
            if byte[0] in [int(number) for number in _ENDS] and os.getpid() == started:
                end(byte[0], None)

    threading.Thread(target=wait, name="signals", daemon=True).start()


def _say(text: str) -> None:
    """Write a message without Python's buffers, which the interrupted code may hold."""
    try:
        os.write(2, text.encode())
    except OSError:
        return


if __name__ == "__main__":
    sys.exit(main())
