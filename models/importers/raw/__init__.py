"""PSS/E RAW files of version 23 to 36: text, layouts of the versions, records by name of their fields."""
