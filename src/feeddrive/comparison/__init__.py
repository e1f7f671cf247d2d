"""The arena: all laws on one axis, over the same work, at equal robustness."""
