"""Scenario files: what is wired, which channels, which events."""
