"""A chain of trivial FMUs and the masters that step it."""
