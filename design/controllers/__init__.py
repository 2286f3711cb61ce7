"""Controllers and banks of them, and those that are bundled."""
