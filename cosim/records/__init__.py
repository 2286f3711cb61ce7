"""Records of measurements: reading, mode meter, source location, playback into a model."""
