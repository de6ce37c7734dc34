"""Command line: parsing of arguments, subcommands, and errors as one line and an exit status.

Exit status: 0 success; 1 a missing part (doctor), a comparison out of tolerance (validate) or a failure of the program;
2 invalid input; 130 stopped by Ctrl-C.
"""

import argparse
import os
import re
import sys
from collections.abc import Sequence
from typing import NoReturn

from sarmitsuba import __version__
from sarmitsuba.commands import COMMANDS
from sarmitsuba.commands.console import Console
from sarmitsuba.core.errors import SarmitsubaError
from sarmitsuba.core.parameters import did_you_mean, one_line
from sarmitsuba.core.registry import load_extension
from sarmitsuba.machine.atomic import describe_end, withdraw_resuming
from sarmitsuba.machine.memory import check_limits
from sarmitsuba.machine.regular_files import check_text

EXIT_OK, EXIT_USER, EXIT_INTERRUPTED = 0, 2, 130


class _Parser(argparse.ArgumentParser):
    """Argument parser that reports errors on one line."""

    def error(self, message: str) -> NoReturn:
        """End with one line, which names the choice that was meant."""
        found = re.search(r"invalid choice: '(.*?)' \(choose from (.*)\)$", message)
        if found is not None:
            guess = did_you_mean(found[1], [word.strip("' ") for word in found[2].split(",")])
            message = f"{message[: found.end(1) + 1]}{guess}{message[found.end(1) + 1 :]}"
        if (missing := re.match(r"argument (--[\w-]+).*: expected one argument", message)) is not None:
            message += f"; a value that starts with a minus sign needs {missing[1]}=VALUE"
        print(f"error: {message} (see {self.prog} --help)", file=sys.stderr)
        sys.exit(EXIT_USER)


class _CommandParser(_Parser):
    """Parser of a subcommand: names the option that an unknown one may have meant."""

    def parse_known_args(self, args=None, namespace=None):  # type: ignore[no-untyped-def]
        parsed, rest = super().parse_known_args(args, namespace)
        if rest:
            known = [option for action in self._actions for option in action.option_strings]
            guess = did_you_mean(rest[0].partition("=")[0], known) if rest[0].startswith("-") else ""
            self.error(f"unrecognized arguments: {' '.join(rest)}{guess}")
        return parsed, rest


def build_parser() -> argparse.ArgumentParser:
    """Return the parser with every subcommand; load extensions first, their names may be choices of options."""
    parser = _Parser(prog="sarmitsuba", description="Synthetic aperture radar simulator on Mitsuba 3.")
    parser.add_argument("--version", action="version", version=f"sarmitsuba {__version__}")
    _add_extension(parser)
    subparsers = parser.add_subparsers(metavar="COMMAND", required=True, parser_class=_CommandParser)
    for command in COMMANDS:
        sub = subparsers.add_parser(command.NAME, help=command.HELP, description=command.__doc__)
        command.add_arguments(sub)
        _add_extension(sub)
        sub.add_argument("--quiet", action="store_true", help="show errors only")
        sub.add_argument("--verbose", action="store_true", help="show log messages")
        sub.set_defaults(run=command.run)
    return parser


def _add_extension(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--extension",
        action="append",
        default=argparse.SUPPRESS,
        metavar="MODULE_OR_FILE",
        help="Python module or .py file that registers modes, laws, focusers ...; may be given several times",
    )


def _load_extensions(argv: Sequence[str] | None) -> None:
    """Import the modules given by ``--extension``, before or after the command."""
    parser = _Parser(prog="sarmitsuba", add_help=False, allow_abbrev=False)
    _add_extension(parser)
    named, _ = parser.parse_known_args(argv)
    for extension in getattr(named, "extension", ()):
        load_extension(extension)


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line and return the exit status."""
    try:
        check_limits()
        for argument in sys.argv[1:] if argv is None else argv:
            check_text(argument)
        _load_extensions(argv)
    except SarmitsubaError as error:
        Console(quiet=False, verbose=False).complain(str(error))
        return EXIT_USER
    args = build_parser().parse_args(argv)
    console = Console(quiet=args.quiet, verbose=args.verbose)
    withdraw_resuming()
    try:
        with console.reporting():
            status: int = args.run(args, console)
            sys.stdout.flush()
            return status
    except SarmitsubaError as error:
        console.complain(str(error))
        return EXIT_USER
    except MemoryError:
        console.complain("out of memory; choose a smaller image, fewer pulses or a coarser ray_spacing")
        return EXIT_USER
    except KeyboardInterrupt:
        console.complain(f"interrupted; {describe_end()}")
        return EXIT_INTERRUPTED
    except BrokenPipeError:  # the output was closed by its reader, e.g. `| head`
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return EXIT_OK
    except (
        OSError
    ) as error:  # errors of the operating system on a path: name too long, no permission, failing disk
        from sarmitsuba.machine.atomic import reason_of

        where = "" if error.filename is None else f"{one_line(error.filename, 200)}: "
        console.complain(f"{where}{reason_of(error)}")
        return EXIT_USER
