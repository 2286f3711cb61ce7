"""Stability maps of a sweep on one page."""
