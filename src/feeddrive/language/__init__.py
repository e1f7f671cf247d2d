"""Floor 0, the language: numbers, blocks, trees of named states, units, errors."""
