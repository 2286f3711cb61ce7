"""The master: steps FMUs on an integer clock, delays exact."""
