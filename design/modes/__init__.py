"""Modes, sensitivities, and selection of loops."""
