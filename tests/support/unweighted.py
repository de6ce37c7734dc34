"""Images without a window, whose responses have closed forms; the default of the program is a window."""

from functools import partial

import sarmitsuba
from sarmitsuba.focusing.focuser_comparison import compare_focusers as compare

PLAIN = {"range_window": "rectangular", "azimuth_window": "rectangular"}

focus = partial(sarmitsuba.focus, **PLAIN)
render = partial(sarmitsuba.render, **PLAIN)
refine = partial(sarmitsuba.refine, **PLAIN)
compare_focusers = partial(compare, window="rectangular")
