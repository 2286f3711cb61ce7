"""Model reduction with stated errors."""
