"""Report the back end, LLVM, threads, GPU, versions and the ray rate, and how to install missing parts."""

import argparse
import dataclasses
import json

from sarmitsuba.commands.console import Console

NAME = "doctor"
HELP = "check this machine and say what is missing"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this command's arguments."""
    parser.add_argument("--json", action="store_true", help="print the findings as JSON")


def run(args: argparse.Namespace, console: Console) -> int:
    """Return 0 when nothing essential is missing, else 1."""
    from sarmitsuba.loading.doctor import examine

    report = examine()
    if args.json:
        facts = {
            "ok": report.ok,
            "ray_rate_per_s": report.ray_rate,
            "checks": [dataclasses.asdict(c) for c in report.checks],
        }
        console.say(json.dumps(facts, indent=2))
        return 0 if report.ok else 1
    width = max(len(check.name) for check in report.checks)
    for check in report.checks:
        mark = "ok" if check.ok else ("MISSING" if check.essential else "-")
        console.say(f"{check.name:<{width}}  {mark:<8}{check.value}")
        if check.remedy:
            console.say(f"{'':<{width}}  {'':<8}-> {check.remedy}")
    console.say("ready" if report.ok else "not ready: follow the advice at the lines marked MISSING")
    return 0 if report.ok else 1
