"""Common parts of the frequency-domain focusers; see :mod:`sarmitsuba.focusing.frequency_domain.rows`."""
