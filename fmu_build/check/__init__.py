"""The check of FMUs and SSPs, ours or not."""
