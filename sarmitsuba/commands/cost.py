"""Measure error against run time on a scene. Prints a table, draws the Pareto front and recommends a setting."""

import argparse
from contextlib import nullcontext
from typing import TYPE_CHECKING

from sarmitsuba.commands.console import Console
from sarmitsuba.commands.scene_arguments import add_scene_arguments, scene_of

if TYPE_CHECKING:
    from sarmitsuba.apps.cost_report import CostReport
    from sarmitsuba.machine.output import OutputFolder

NAME = "cost"
HELP = "measure error against run time on a scene and recommend a setting"

RECORD, TEXT, PLOT = "cost.json", "cost.md", "cost.png"
STATE = "cost.trials"  # every finished trial


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this command's arguments."""
    add_scene_arguments(parser)
    parser.add_argument(
        "--target-error",
        type=float,
        default=-20.0,
        metavar="DB",
        help="wanted error of the image: energy of the error over energy of the image (default -20)",
    )
    parser.add_argument(
        "--budget",
        type=float,
        metavar="S",
        help="processor seconds for measuring, besides compiling (default: 15 times a run of the scene, at least 60)",
    )
    parser.add_argument("-o", "--output", metavar="OUT", help=f"folder for {RECORD}, {TEXT} and {PLOT}")
    parser.add_argument(
        "--force", action="store_true", help="replace the study of something else in OUT; other files stay"
    )
    parser.add_argument(
        "--resume",
        action="store_true",
        help=f"use what an earlier, also an interrupted study of this scene measured and kept in OUT/{STATE}",
    )


def run(args: argparse.Namespace, console: Console) -> int:
    """Sweep the parameters, print the table, draw the plot."""
    from sarmitsuba.core.errors import SceneError
    from sarmitsuba.loading.tables import INTEGRATOR

    INTEGRATOR["target_error_db"].check_option("--target-error", args.target_error, "cost")
    if args.budget is not None and not 0.0 < args.budget < float("inf"):
        raise SceneError(f"cost: --budget = {args.budget:g} s must be above 0 and finite")
    if not args.target_error < 0.0:
        raise SceneError(f"cost: --target-error = {args.target_error:g} dB must be below 0")
    if args.resume and not args.output:
        raise SceneError("cost: --resume needs -o OUT, the folder of the earlier study")
    from sarmitsuba.apps.cost import study_cost
    from sarmitsuba.machine.journal import remove_journal
    from sarmitsuba.machine.output import output_folder
    from sarmitsuba.simulation.execution.fingerprint import fingerprint

    with output_folder(args.output) if args.output else nullcontext() as folder:
        if folder is not None:
            folder.check_names((RECORD, TEXT, PLOT, STATE))
        scene = scene_of(args)
        run_hash = fingerprint(scene, getattr(args, "extension", ()))
        if folder is not None and not args.force:
            _check_earlier(folder, run_hash)
        console.expect({"cost": args.budget or 1.0}, at_most=True)  # one stage: any weight is the whole
        console.busy("running the scene once")
        state = None
        if folder is not None:
            if not args.resume:
                remove_journal(folder.path / STATE)
            folder.announce(STATE)
            state = folder.path / STATE
        try:
            report = study_cost(
                scene,
                target_error_db=args.target_error,
                budget=args.budget or 0.0,
                progress=console.progress,
                state=state,
                run_hash=run_hash,
                say=console.say,
            )
        finally:
            if folder is not None:
                folder.enter(STATE)
        console.end_progress()
        command = f"python -m sarmitsuba render {args.scene}" + (
            f" --radar {args.radar}" if args.radar else ""
        )
        command += "".join(f" -D {name}={value}" for name, value in args.define)
        text = _text(report, scene.name, command)
        console.say(text)
        if folder is not None:
            _save(folder, report, scene.name, run_hash, text)
    return 0


def table(report: "CostReport") -> list[str]:
    """Markdown lines of the sweeps."""
    lines = [
        "| parameter | value | error dB | seconds (piece) | seconds (whole) | MB | |",
        "|---|---|--:|--:|--:|--:|---|",
    ]
    for row in report.rows:
        error = "-" if row.error_db <= -80.0 else f"{row.error_db:.1f}"
        megabytes = f"{row.megabytes:.0f}" if row.megabytes == row.megabytes else "-"
        lines.append(
            f"| {row.parameter} | {row.value} | {error} | {row.seconds:.2f} | {row.full_seconds:.2f} "
            f"| {megabytes} | {row.remark} |"
        )
    return lines


def _text(report: "CostReport", name: str, command: str) -> str:
    lines = [
        f"{name}: parameters were swept on {report.piece}; errors are relative to {report.reference}, or, within a "
        "sweep, to its best value",
        *table(report),
        "",
        *_list_skipped(report),
        f"the scene's own settings on the whole scene: {report.full_seconds:.2f} s "
        f"({'measured' if report.own.measured else 'predicted'})",
        f"cheapest combinations (m: measured; errors are of {report.proof.text}, relative to "
        f"{report.estimated_against}; the unmarked ones are estimated from the measured ones):",
    ]
    lines += [
        f"  {'m' if c.measured else ' '} {c.error_db:6.1f} dB {c.seconds:8.2f} s  {_short(c.changes)}"
        for c in report.front
    ]
    found = report.recommendation
    best, target = found.setting, found.target_error_db
    if found.met:
        lines.append(f"recommended for {target:g} dB: {best.estimate()}")
        if found.remark:
            lines.append(f"  {found.remark}")
    elif report.unseen_db > target:
        lines.append(
            f"{target:g} dB cannot be shown: the bounces after the reference's last may hold {report.unseen_db:.0f} dB "
            f"of the image's energy; the most accurate: {best.estimate()}; a lossy material ends such paths earlier"
        )
    else:
        lines.append(
            f"no single pass meets {target:g} dB; the most accurate: {best.estimate()} "
            f"per pass; render --target-error {target:g} adds passes until it is met"
        )
    if report.check:
        lines.append(
            ("checked with other rays" if "ray_spacing" in best.changes else "run again with the same rays")
            + f": {report.check.error_db:.1f} dB on {report.proof.text}, "
            f"{report.check.seconds:.2f} s on the whole scene"
        )
    else:
        lines.append("not checked: the time budget ran out first")
    lines.append(f"  {command} {found.options()} -o OUT")
    lines.append(
        "  (processor seconds for simulating and focusing, not start-up, reading, compiling and writing)"
    )
    compiling = f" and {report.compile_seconds:.0f} s of compiling" if report.compile_seconds >= 1.0 else ""
    again = f"; {report.reused} trials of an earlier one were not repeated" if report.reused else ""
    lines.append(f"this study took {report.seconds:.0f} s of {report.budget:.0f} s{compiling}{again}")
    return "\n".join(lines)


def _list_skipped(report: "CostReport") -> list[str]:
    """Line about the sweeps that the budget left out."""
    names = ", ".join(report.skipped)
    return [f"not swept or cut short: {names}; a larger --budget with --resume sweeps them"] if names else []


def _short(changes: object) -> str:
    assert isinstance(changes, dict)
    return ", ".join(f"{k} {v:.3g}" if isinstance(v, float) else f"{k} {v}" for k, v in changes.items())


def _check_earlier(folder: "OutputFolder", run_hash: str) -> None:
    """Raise an OutputError where the folder holds the study of another scene."""
    from sarmitsuba.core.errors import OutputError
    from sarmitsuba.machine import output as parameter_file

    if not folder.owns(RECORD):
        return
    earlier = parameter_file.read(folder.path / RECORD)
    if earlier.get("run_hash", run_hash) != run_hash:
        raise OutputError(
            f"{folder.path}: holds a study of another scene, of other settings or of another version of the program; "
            "choose another -o, or use --force to replace it"
        )


def _save(folder: "OutputFolder", report: "CostReport", name: str, run_hash: str, text: str) -> None:
    from sarmitsuba.machine import output as parameter_file
    from sarmitsuba.machine.atomic import atomic_path
    from sarmitsuba.view.charts import cost_figure, save_figure

    record = {
        "scene": name,
        "run_hash": run_hash,
        "rows": report.rows,
        "front": report.front,
        "recommended": report.recommendation.setting,
        "options": report.recommendation.options(),
        "target_error_db": report.recommendation.target_error_db,
        "met": report.recommendation.met,
        "remark": report.recommendation.remark,
        "piece": report.piece,
        "estimate": "measured" if report.recommendation.setting.measured else "predicted",
        "reference": report.reference,
        "estimated_against": report.estimated_against,
        "estimated_against_factor": report.proof.factor,
        "measured_on": report.proof.text,
        "check": report.check,
        "plain_seconds": report.full_seconds,
        "budget": report.budget,
        "skipped": report.skipped,
        "reused": report.reused,
        "seconds": report.seconds,
        "compile_seconds": report.compile_seconds,
    }
    with folder.writing(RECORD) as path:
        parameter_file.write(path, record)
    with folder.writing(TEXT) as path, atomic_path(path) as temporary:
        temporary.write_text(text + "\n", encoding="utf-8")
    points = [(c.seconds, c.error_db) for c in report.candidates]
    front = [(c.seconds, c.error_db) for c in report.front]
    best, target = report.recommendation.setting, report.recommendation.target_error_db
    figure = cost_figure(points, front, (best.seconds, best.error_db), target, name)
    with folder.writing(PLOT) as path:
        save_figure(figure, path)
