"""From scene files (XML, Mitsuba objects) to the frozen data model of ``sarmitsuba.scene``."""
