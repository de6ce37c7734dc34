"""Console output of the command line: results on stdout, warnings and progress on stderr."""

import logging
import os
import re
import sys
import threading
import time
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import TYPE_CHECKING, TextIO

from sarmitsuba.core.errors import GuessWarning, SarmitsubaWarning, plain_line
from sarmitsuba.core.progress import Journey, Standing
from sarmitsuba.core.timing import Clock

if TYPE_CHECKING:
    from tqdm import tqdm

# control characters of a terminal; tables keep their line ends and tabs
_CONTROL = re.compile(r"[\x00-\x08\x0b-\x1f\x7f-\x9f]")
_BAR = "{desc:<12}{percentage:3.0f}% |{bar}| {elapsed}{postfix}"
# without a terminal: a line every tenth of the run, none in runs shorter than this, s
_LINES, _QUICK = 10, 2.0
# work that takes longer than this is named on a terminal, s
_PROMPT = 1.0


class Console:
    """Output of the subcommands to the user; nothing else prints.

    Parameters
    ----------
    quiet : hide results, progress and warnings; errors and guesses of the physics are still shown
    verbose : show log messages of the libraries
    clock : time source of the progress, s
    """

    def __init__(
        self, *, quiet: bool = False, verbose: bool = False, clock: Clock = time.perf_counter
    ) -> None:
        self.quiet = quiet
        self.verbose = verbose
        self.warnings: list[str] = []
        self.notes: list[str] = []
        self._bar: tqdm | None = None
        self._named: threading.Timer | None = None
        self._clock = clock
        self.expect({})

    def say(self, text: str) -> None:
        """Print a result."""
        if not self.quiet:
            self._line(_CONTROL.sub(" ", text), sys.stdout)

    def complain(self, text: str) -> None:
        """Print an error on one line, even if its text has several."""
        self.end_progress()
        self._line(f"error: {plain_line(text)}", sys.stderr)

    def warn(self, text: str, *, always: bool = False) -> None:
        """Print a warning on one line, ``always`` even when quiet, and remember it; the same text only once."""
        line = plain_line(text)
        if line not in self.warnings:
            self.warnings.append(line)
            if always or not self.quiet:
                self._line(f"warning: {line}", sys.stderr)

    def busy(self, work: str) -> None:
        """Show the name of work without a known end, if it takes long, until the next name or progress."""
        self._idle()
        if self.quiet:
            return
        patience = _PROMPT if sys.stderr.isatty() else _QUICK
        self._named = threading.Timer(patience, self._line, (f"{work} ...", sys.stderr))
        self._named.daemon = True
        self._named.start()

    def _idle(self) -> None:
        if self._named is not None:
            self._named.cancel()
        self._named = None

    def expect(self, seconds: Mapping[str, float], *, at_most: bool = False) -> None:
        """Announce a run by the predicted times of its stages; progress is then that of the whole run.

        ``at_most``: the run may end before they are used up.
        """
        self.end_progress()
        self._journey, self._lines, self._at_most = Journey(seconds, self._clock), 0, at_most

    def note(self, text: str) -> None:
        """Print an assumption on one line, unless it was a warning already; the same text is printed only once."""
        line = plain_line(text)
        if line not in self.warnings and line not in self.notes:
            self.notes.append(line)
            if not self.quiet:
                self._line(f"note: {line}", sys.stderr)

    def progress(self, stage: str, done: float, total: float, info: Mapping[str, float], /) -> None:
        """Show the progress of the run: a bar, or without a terminal a line every tenth. Library stages call this."""
        if self.quiet:
            return
        self._idle()
        standing = self._journey.reached(stage, done / total if total > 0.0 else 1.0)
        if not sys.stderr.isatty():
            self._progress_line(stage, standing, info)
            return
        from tqdm import tqdm

        bar = self._bar
        if bar is None:
            # a terminal of unknown size reports 0, where tqdm would draw nothing
            columns = os.get_terminal_size(sys.stderr.fileno()).columns or 80
            self._bar = bar = tqdm(
                total=1.0,
                desc=stage,
                bar_format=_BAR,
                file=sys.stderr,
                mininterval=0.2,
                ncols=columns,
                nrows=20,
            )
        bar.set_description_str(stage, refresh=False)
        bar.set_postfix_str(", ".join(self._remarks(standing, info)), refresh=False)
        bar.update(standing.share - bar.n)
        if standing.share >= 1.0:
            self.end_progress()

    def _progress_line(self, stage: str, standing: Standing, info: Mapping[str, float]) -> None:
        lines = int(_LINES * standing.share + 1e-9)
        if lines <= self._lines or standing.elapsed < _QUICK:
            return
        self._lines = lines
        remarks = ", ".join([f"{_clock_time(standing.elapsed)} so far", *self._remarks(standing, info)])
        self._line(f"{100 * lines // _LINES:3d} % {stage}: {remarks}", sys.stderr)

    def _remarks(self, standing: Standing, info: Mapping[str, float]) -> list[str]:
        """Remaining time and rates, as shown beside the progress."""
        from tqdm import tqdm

        most = "at most " if self._at_most else ""
        left = [] if standing.left == float("inf") else [f"{most}{_clock_time(standing.left)} left"]
        return [*left, *(f"{tqdm.format_sizeof(value)} {name}" for name, value in info.items())]

    def end_progress(self) -> None:
        """Leave the last bar as it is and start a new line."""
        self._idle()
        if self._bar is not None:
            self._bar.close()
        self._bar = None

    @contextmanager
    def reporting(self) -> Iterator[None]:
        """Show the program's warnings and, when verbose, log messages and other packages' warnings."""

        def show(
            message: Warning | str,
            category: type[Warning],
            filename: str,
            lineno: int,
            file: TextIO | None = None,
            line: str | None = None,
        ) -> None:
            if issubclass(category, SarmitsubaWarning):
                self.warn(str(message), always=issubclass(category, GuessWarning))
            elif self.verbose:
                text = warnings.formatwarning(message, category, filename, lineno, line)
                self._line(plain_line(text), sys.stderr)

        logger = logging.getLogger("sarmitsuba")
        handler = _LogHandler(self)
        with warnings.catch_warnings():
            warnings.simplefilter("always", SarmitsubaWarning)
            warnings.showwarning = show
            if self.verbose:
                logger.addHandler(handler)
                logger.setLevel(logging.DEBUG)
            try:
                yield
            finally:
                logger.removeHandler(handler)
                self.end_progress()

    def _line(self, text: str, file: TextIO) -> None:
        if self._bar is not None:
            self._bar.write(text, file=file)
        else:
            print(text, file=file, flush=True)


def _clock_time(seconds: float) -> str:
    """``4:07`` or ``1:04:07``."""
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02d}:{rest:02d}" if hours else f"{minutes}:{rest:02d}"


class _LogHandler(logging.Handler):
    def __init__(self, console: Console) -> None:
        super().__init__()
        self._console = console

    def emit(self, record: logging.LogRecord) -> None:
        self._console._line(plain_line(f"{record.name}: {record.getMessage()}"), sys.stderr)
