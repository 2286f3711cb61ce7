"""Linear models: linearisation, norms."""
