"""Records of measurements: read, metered, located, played in."""
