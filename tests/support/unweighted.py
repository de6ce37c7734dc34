"""Images without a window, whose responses have closed forms; the default of the program is a window."""

from functools import partial

import sarmitsuba
from sarmitsuba.signal.focusing.comparison import compare_focusers as compare

focus = partial(sarmitsuba.focus, range_window="rectangular", azimuth_window="rectangular")
render = partial(sarmitsuba.render, range_window="rectangular", azimuth_window="rectangular")
refine = partial(sarmitsuba.refine, range_window="rectangular", azimuth_window="rectangular")
compare_focusers = partial(compare, window="rectangular")
