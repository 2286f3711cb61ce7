"""C to FMI 2.0: build, open, check."""
