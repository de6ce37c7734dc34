"""Text of the page can be read: contrast of its colours, after WCAG 2.1 (relative luminance, 1.4.3)."""

import re
from pathlib import Path

from sarmitsuba.view.page import __file__ as package

STYLE = (Path(package).parent / "web" / "style.css").read_text(encoding="utf-8")
COLOURS = dict(re.findall(r"--(\w+): (#[0-9a-f]{6})", STYLE))
LEAST = 4.5  # of normal text, level AA


def luminance(colour: str) -> float:
    parts = [int(colour[i : i + 2], 16) / 255 for i in (1, 3, 5)]
    red, green, blue = (c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in parts)
    return 0.2126 * red + 0.7152 * green + 0.0722 * blue


def contrast(one: str, other: str) -> float:
    dark, light = sorted((luminance(one), luminance(other)))
    return (light + 0.05) / (dark + 0.05)


def test_contrast_of_known_pairs() -> None:
    # tol: the standard's own examples, to their digits
    assert contrast("#000000", "#ffffff") == 21.0
    assert abs(contrast("#777777", "#ffffff") - 4.48) < 0.005


def test_text_stands_out_from_every_ground() -> None:
    grounds = [
        COLOURS["ground"],
        COLOURS["panel"],
        "#0b1016",
    ]  # the last is the 3-D scene's and the canvases'
    texts = ("text", "quiet", "accent", "one", "two", "three", "more", "beam")
    found = {(name, ground): contrast(COLOURS[name], ground) for name in texts for ground in grounds}
    assert {pair: ratio for pair, ratio in found.items() if ratio < LEAST} == {}


def test_rules_with_their_own_ground_and_text() -> None:
    """Buttons, pressed and not, rows under the pointer, the line that says what failed."""
    rules = re.findall(r"^([^{@\n]+)\{([^}]*)\}", STYLE, re.MULTILINE)
    checked = 0
    for selector, body in rules:
        ground = re.search(r"background: (#[0-9a-f]{3,6}|var\(--\w+\))", body)
        if ground is None:
            continue
        text = re.search(r"(?<![-\w])color: (#[0-9a-f]{3,6}|var\(--\w+\))", body)
        pair = [_plain(text[1] if text else "var(--text)"), _plain(ground[1])]
        if 'bar button[aria-pressed="true"]' in selector:
            pair[0] = "#10151c"  # of the rule for every pressed button
        assert contrast(*pair) >= LEAST, (selector, pair)
        checked += 1
    assert checked >= 8


def _plain(colour: str) -> str:
    named = re.fullmatch(r"var\(--(\w+)\)", colour)
    plain = COLOURS[named[1]] if named else colour
    return plain if len(plain) == 7 else "#" + "".join(2 * digit for digit in plain[1:])
