"""``python -m sarmitsuba``."""

import gc
import mmap
import os
import signal
import sys
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from types import FrameType

from sarmitsuba.machine.atomic import describe_end, remove_shared, remove_unfinished, share_unfinished
from sarmitsuba.machine.memory import share_one_heap

# new objects after which Python looks for unreachable cycles: the usual 700 takes 5 % of a short run, most of it by
# going through the libraries' modules again and again
_COLLECT_AFTER = 20_000
# signal, message, and the exit status by the shell's convention of 128 + its number
_ENDS = {
    signal.SIGINT: ("interrupted", 130),
    signal.SIGTERM: ("terminated", 143),
}
# s until a process that answers no signal is ended from outside, and between looks at it
_PATIENCE, _LOOK = 1.0, 0.02


def main() -> int:
    """Run the command line; Ctrl-C and SIGTERM end it at once with one line.

    An exception in foreign code (half-imported modules, callbacks of Mitsuba) would end in a traceback or a crash: the
    process ends without one, and unfinished files are removed.
    """
    _open_streams()
    share_one_heap()  # before the first thread
    started, ending = os.getpid(), threading.RLock()
    shared = share_unfinished()

    def end(number: int, frame: FrameType | None) -> None:
        shared[0] = 1
        # handler and watching thread may both receive a signal: the second waits for the end of the process
        ending.acquire()
        if threading.current_thread() is threading.main_thread():
            for each in _ENDS:
                signal.signal(each, signal.SIG_IGN)
        said, status = _ENDS[signal.Signals(number)]
        if os.getpid() == started:  # a forked reader process owns no unfinished files
            remove_unfinished()
            begin = "\n" if sys.stderr is not None and sys.stderr.isatty() else ""
            _say(f"{begin}error: {said}; {describe_end()}\n")
        os._exit(status)

    _watch(end, shared)
    for number in _ENDS:
        if (
            signal.getsignal(number) is not signal.SIG_IGN
        ):  # as `nohup` and background jobs of a shell have it
            signal.signal(number, end)
    gc.set_threshold(_COLLECT_AFTER)
    from sarmitsuba import cli

    status = cli.main()
    # all is written: a signal during the interpreter's shutdown would crash it
    for number in _ENDS:
        signal.signal(number, signal.SIG_IGN)
    signal.set_wakeup_fd(-1)
    return status


def _open_streams() -> None:
    """Open the standard streams that a parent has closed (``>&-``): files would otherwise get their numbers."""
    while (handle := os.open(os.devnull, os.O_RDWR)) <= 2:
        continue
    os.close(handle)
    sys.stdout = sys.stdout or open(os.devnull, "w", encoding="utf-8")
    sys.stderr = sys.stderr or open(os.devnull, "w", encoding="utf-8")


def _watch(end: Callable[[int, FrameType | None], None], shared: mmap.mmap) -> None:
    """Handle signals where Python calls no handler.

    While the main thread is in C code that lets other threads run (kernels, linear algebra), a thread ends the
    process. C code that does not (PROJ, HDF5) is ended by a process, which receives every signal first and passes it
    on to the thread.
    """
    try:
        read, write = os.pipe()
    except OSError:  # too few files may be open: the program ends with that in a moment
        return
    os.set_blocking(write, False)
    started = os.getpid()
    if hasattr(os, "fork"):
        try:
            thread_read, thread_write = os.pipe()
            guard = os.fork()
        except OSError:  # no process may be started, or no file opened: the thread alone
            thread_read = read
        else:
            if guard == 0:
                for each in (0, 1, write, thread_read):
                    with suppress(OSError):  # closed before
                        os.close(each)
                _guard(started, read, thread_write, shared)
            os.close(read)
            os.close(thread_write)
            read = thread_read
    signal.set_wakeup_fd(write, warn_on_full_buffer=False)

    def wait() -> None:
        for byte in iter(lambda: os.read(read, 1), b""):
            if byte[0] in [int(number) for number in _ENDS] and os.getpid() == started:
                end(byte[0], None)

    with suppress(RuntimeError):  # no thread may be started: the handler alone
        threading.Thread(target=wait, name="signals", daemon=True).start()


def _guard(guarded: int, read: int, pass_on: int, shared: mmap.mmap) -> None:
    """Body of the process that ends another which answers no signal; does not return.

    It ends when the other does, which closes the pipe.
    """
    try:
        for ignored in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT):
            signal.signal(ignored, signal.SIG_IGN)
        for byte in iter(lambda: os.read(read, 1), b""):
            os.write(pass_on, byte)
            for number, (said, _) in _ENDS.items():
                if byte[0] == number and not _answers(guarded, shared):
                    remove_shared(shared)
                    os.kill(guarded, signal.SIGKILL)
                    while os.getppid() == guarded:
                        time.sleep(_LOOK)
                    remove_shared(shared)
                    _say(
                        f"error: {said} within a library that answers no signal; no half-written file was left behind\n"
                    )
                    return
    finally:
        os._exit(0)


def _answers(guarded: int, shared: mmap.mmap) -> bool:
    """Whether the process ends, or has begun to."""
    until = time.monotonic() + _PATIENCE  # a look takes longer where many processes wait for a processor
    while time.monotonic() < until:
        if shared[0] or os.getppid() != guarded:
            return True
        time.sleep(_LOOK)
    return False


def _say(text: str) -> None:
    """Write a message without Python's buffers, which the interrupted code may hold."""
    try:
        os.write(2, text.encode())
    except OSError:
        return


if __name__ == "__main__":
    sys.exit(main())
