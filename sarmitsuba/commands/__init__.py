"""Subcommands of the command line, one module each.

A module has ``NAME``, ``HELP``, ``add_arguments(parser)`` and ``run(args, console) -> exit status``. It imports
other packages only when it runs, so that ``doctor`` works where they are missing. A module added to
``COMMANDS`` becomes a subcommand.
"""

from sarmitsuba.commands import (
    cost,
    dataset,
    depth,
    derivative,
    doctor,
    explain,
    fit_scene,
    focus,
    importing,
    insar,
    interferogram,
    link,
    picture,
    polarimetry,
    quality,
    rcs,
    render,
    scenes,
    studio,
    validate,
    view,
)

COMMANDS = (
    render,
    focus,
    view,
    picture,
    quality,
    polarimetry,
    interferogram,
    insar,
    rcs,
    dataset,
    studio,
    explain,
    link,
    cost,
    depth,
    derivative,
    fit_scene,
    scenes,
    importing,
    validate,
    doctor,
)

__all__ = ["COMMANDS"]
