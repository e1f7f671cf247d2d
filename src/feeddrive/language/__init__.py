"""The language in which laws are written: numbers, blocks, trees of named states, units, errors."""
