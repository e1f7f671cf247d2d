"""The independent proof that a planned motion keeps its limits in continuous time."""
