"""From a scene to raw data or an image: sampling plan, pilot, passes, error bars, prediction, RCS, paths."""
