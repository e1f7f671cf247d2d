"""Floor 2, the loop: one sample of one axis, and the engine that runs, linearises and differentiates it."""
