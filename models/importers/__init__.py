"""Grids from files of other programs."""
