"""Motors, current loop and dead time."""
