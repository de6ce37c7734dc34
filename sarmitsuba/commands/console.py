"""What the command line shows while it works: results on stdout, warnings and progress on stderr."""

import logging
import os
import sys
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import TYPE_CHECKING, TextIO

from sarmitsuba.errors import SarmitsubaWarning

if TYPE_CHECKING:
    from tqdm import tqdm

_BAR = "{desc:<12}{percentage:3.0f}% |{bar}| {elapsed}, {remaining} left{postfix}"


class Console:
    """The only way that subcommands speak to the user.

    Parameters
    ----------
    quiet : hide results, progress and warnings; errors are still shown
    verbose : show log messages of the libraries
    """

    def __init__(self, *, quiet: bool = False, verbose: bool = False) -> None:
        self.quiet = quiet
        self.verbose = verbose
        self.warnings: list[str] = []
        self.notes: list[str] = []
        self._bar: tqdm | None = None
        self._stage = ""

    def say(self, text: str) -> None:
        """Print a result."""
        if not self.quiet:
            self._line(text, sys.stdout)

    def complain(self, text: str) -> None:
        """Print an error on one line, even if its text has several."""
        self.end_progress()
        self._line(f"error: {' '.join(text.split())}", sys.stderr)

    def warn(self, text: str) -> None:
        """Print a warning on one line and remember it; the same text is printed only once."""
        line = " ".join(text.split())
        if line not in self.warnings:
            self.warnings.append(line)
            if not self.quiet:
                self._line(f"warning: {line}", sys.stderr)

    def note(self, text: str) -> None:
        """Print on one line what was assumed, unless it was a warning already; the same text is printed only once."""
        line = " ".join(text.split())
        if line not in self.warnings and line not in self.notes:
            self.notes.append(line)
            if not self.quiet:
                self._line(f"note: {line}", sys.stderr)

    def progress(self, stage: str, done: float, total: float, info: Mapping[str, float], /) -> None:
        """Draw the progress bar of a stage. Library stages call this to report progress."""
        if self.quiet or not sys.stderr.isatty():
            return
        from tqdm import tqdm

        bar = self._bar
        if bar is None or stage != self._stage:
            self.end_progress()
            self._stage = stage
            # a terminal may not know its size and say 0, where tqdm would draw nothing
            columns = os.get_terminal_size(sys.stderr.fileno()).columns or 80
            self._bar = bar = tqdm(
                total=total,
                desc=stage,
                bar_format=_BAR,
                file=sys.stderr,
                mininterval=0.2,
                ncols=columns,
                nrows=20,
            )
        bar.total = total
        if info:
            rates = (f"{tqdm.format_sizeof(value)} {name}" for name, value in info.items())
            bar.set_postfix_str(", ".join(rates), refresh=False)
        bar.update(done - bar.n)
        if done >= total:
            self.end_progress()

    def end_progress(self) -> None:
        """Leave the last bar as it is and start a new line."""
        if self._bar is not None:
            self._bar.close()
        self._bar, self._stage = None, ""

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
                self.warn(str(message))
            elif self.verbose:
                self._line(warnings.formatwarning(message, category, filename, lineno, line), sys.stderr)

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


class _LogHandler(logging.Handler):
    def __init__(self, console: Console) -> None:
        super().__init__()
        self._console = console

    def emit(self, record: logging.LogRecord) -> None:
        self._console._line(f"{record.name}: {record.getMessage()}", sys.stderr)


__all__ = ["Console"]
