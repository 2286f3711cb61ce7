"""FMUs opened from Python."""
