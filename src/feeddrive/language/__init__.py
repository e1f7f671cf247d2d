"""The language of control laws: numbers, blocks, trees of named states, units, errors."""
