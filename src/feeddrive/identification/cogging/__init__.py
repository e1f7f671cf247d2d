"""Identification of cogging: from force over position to the harmonics of the cogging force."""
