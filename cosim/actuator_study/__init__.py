"""Which actuator damps a mode best: one grid, equal effort and equal installed power, kind by kind."""
