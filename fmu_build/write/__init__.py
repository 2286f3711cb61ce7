"""From blocks to FMI 2.0 FMUs: description, documentation, compiler, archive."""
