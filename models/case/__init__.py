"""Case files: reading, checking, changing, events, writing."""
