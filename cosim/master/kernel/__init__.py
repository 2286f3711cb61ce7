"""The master's steps in compiled code."""
