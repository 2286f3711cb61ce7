"""Blocks: the variables and numbers that become an FMU."""
