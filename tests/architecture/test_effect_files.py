"""An effect that the kernel obeys is known to one module of the kernel, but for a few that are the loop itself.

``python tests/architecture/test_effect_files.py`` prints the number of files that read each flag.
"""

import re
from pathlib import Path

from sarmitsuba.effects.effect import EFFECTS

ROOT = Path(__file__).parents[2]
PACKAGE = ROOT / "sarmitsuba"
# the loop itself, and slabs, which decide two flags
IN_SEVERAL = {"coherent", "diffuse", "multi_bounce", "slabs"}


def kernel_flags() -> list[str]:
    """Switches of built-in effects, without the list of channels."""
    here = [e for e in EFFECTS if type(e).__module__.startswith("sarmitsuba.")]
    return sorted({flag for effect in here for flag in effect.kernel_flags} - {"channels"})


def readers(flag: str) -> list[str]:
    """Files that read a flag, or hold its stage, other than the effect itself; relative to the package."""
    reads = re.compile(rf"flags\.{flag}\b")
    stage = re.compile(rf'name: ClassVar\[str\] = "{flag}"')
    found = []
    for path in sorted(PACKAGE.rglob("*.py")):
        name = path.relative_to(PACKAGE).as_posix()
        text = path.read_text(encoding="utf-8")
        if reads.search(text) or (name.startswith("tracing/kernel/stages/") and stage.search(text)):
            found.append(name)
    return [name for name in found if not name.startswith("effects/")]


def in_kernel(flag: str) -> list[str]:
    """Those of the trace kernel, relative to its folder."""
    return [name.removeprefix("tracing/") for name in readers(flag) if name.startswith("tracing/")]


def test_an_effect_is_known_to_one_module_of_the_kernel() -> None:
    many = {flag: in_kernel(flag) for flag in kernel_flags() if len(in_kernel(flag)) > 1}
    assert set(many) == IN_SEVERAL


if __name__ == "__main__":
    for flag in kernel_flags():
        print(
            f"{flag:20s} {len(in_kernel(flag))} of the kernel, {len(readers(flag))} in all: {', '.join(readers(flag))}"
        )
