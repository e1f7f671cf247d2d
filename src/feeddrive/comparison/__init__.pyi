"""Comparison of all laws on one axis, with the same motions and loads, at equal robustness."""

# written by `make stubs`

from feeddrive.comparison.compare import Comparison as Comparison
from feeddrive.comparison.compare import compare_laws as compare_laws
from feeddrive.comparison.report import write_comparison as write_comparison
