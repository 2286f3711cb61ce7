"""Records of measurements as files have them: formats, names of channels, even time axis."""
