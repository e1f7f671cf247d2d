"""Linear mechanics."""
