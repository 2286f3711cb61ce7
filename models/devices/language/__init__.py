"""The language of device files: what a file may say, and what it means."""
