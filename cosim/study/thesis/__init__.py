"""What belongs to one thesis only: its statements, printed values and specification."""
