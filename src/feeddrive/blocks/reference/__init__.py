"""References: motions in closed form or from logs."""
