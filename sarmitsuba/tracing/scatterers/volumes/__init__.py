"""Volumes: tree crowns."""
