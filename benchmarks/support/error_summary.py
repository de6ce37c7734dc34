"""Table of settings to choose from, by the figures of the section "Error against seconds" of the benchmarks' page."""

import re
from collections.abc import Mapping

SOURCE = "error_time"
# purpose, name of the varied setting and its value in the section, and what to write in a command
CHOICES = (
    ("the automatic settings", "", "", "nothing"),
    ("a look in a second or two", "method", "image", "`--method image`"),
    ("long blocks", "key-pulse interval", "256", "`-D sar_path.key_pulse_interval=256`"),
    ("coarser rays", "ray spacing", "2 x", "`-D sar_path.ray_spacing=` twice the stated one"),
    ("finer rays", "ray spacing", "0.71 x", "`-D sar_path.ray_spacing=` 0.71 of the stated one"),
    ("short blocks", "key-pulse interval", "64", "`-D sar_path.key_pulse_interval=64`"),
    ("every pulse traced", "method", "raw (time scaled)", "`--method raw`"),
)
WORDS = """## Which setting should I choose?

Leave the settings automatic; then ask for a wanted error, `--target-error`, if the stated one is too large. Measured
on two scenes, error of the image against a converged one, and seconds of the simulation:

{table}

![Error against seconds: front](images/benchmarks/error_time_front.png)

References differ from section to section: here a converged image of other rays, below often the same rays with one
thing changed.

"""


def table(sections: Mapping[str, str]) -> str:
    """The summary, from the sections of the page by benchmark; empty where the figures are not on it."""
    scenes = _figures(sections.get(SOURCE, ""))
    if not scenes:
        return ""
    rows = [
        "| wanted | write | " + " | ".join(f"{name}: dB, s" for name in scenes) + " |",
        "|---|---|" + "---|" * len(scenes),
    ]
    for purpose, varied, value, option in CHOICES:
        cells = [found.get((varied, value), "-") for found in scenes.values()]
        if any(cell != "-" for cell in cells):
            rows.append(f"| {purpose} | {option} | {' | '.join(cells)} |")
    return WORDS.format(table="\n".join(rows))


def _figures(section: str) -> dict[str, dict[tuple[str, str], str]]:
    """Error and seconds by varied setting and value, by scene; that of the automatic settings under empty names."""
    scenes: dict[str, dict[tuple[str, str], str]] = {}
    for line in section.splitlines():
        begin = re.match(r"\*\*(\S+): automatic settings (\S+) dB in (\S+) s", line)
        if begin:
            scenes[begin[1]] = {("", ""): f"{begin[2]}, {begin[3]}"}
        elif scenes and line.startswith("| ") and not line.startswith("| varied"):
            varied, text = line.strip("| ").split(" | ")
            for item in text.replace("**", "").split("; "):
                value, _, figures = item.partition(": ")
                scenes[list(scenes)[-1]][varied, value] = figures
    return scenes
