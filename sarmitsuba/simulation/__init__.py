"""Simulation of raw data, images, RCS and path tables: sampling plan, pilot, passes, error bars, prediction."""
