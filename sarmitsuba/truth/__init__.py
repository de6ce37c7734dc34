"""Closed forms, cases and validation."""
