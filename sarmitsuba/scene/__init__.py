"""Frozen data model of a scene: geometry, settings, scene."""
