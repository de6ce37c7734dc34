"""What the frequency-domain focusers share; see :mod:`sarmitsuba.focusing.frequency_domain.rows`."""
