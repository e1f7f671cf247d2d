"""Floor 5, doors: the command line."""
