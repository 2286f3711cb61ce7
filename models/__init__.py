"""Physics in C, case data, and what a plant is."""
