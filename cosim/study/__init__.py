"""The study of a case, end to end."""
