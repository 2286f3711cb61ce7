"""The wired loop for other tools: SSP, container FMU."""
