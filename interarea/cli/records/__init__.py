"""Commands on records of measurements."""
