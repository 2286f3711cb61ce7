"""Fixed-order design for many operating points."""
