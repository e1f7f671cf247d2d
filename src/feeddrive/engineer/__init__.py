"""Floor 3, the engineer: analysis of loops and measurements."""
