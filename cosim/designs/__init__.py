"""Design files, comparison of designs, controllers in files."""
