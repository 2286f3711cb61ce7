"""Modes, sensitivities, and which loop to close."""
