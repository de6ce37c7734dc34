"""Common parts of the frequency-domain focusers; see :mod:`sarmitsuba.signal.focusing.frequency_domain.rows`."""
