"""``python -m sarmitsuba``."""

import sys


def main() -> int:
    """Run the command line; Ctrl-C is quiet even while modules are still loading."""
    try:
        from sarmitsuba import cli

        return cli.main()
    except KeyboardInterrupt:
        return 130


if __name__ == "__main__":
    sys.exit(main())
