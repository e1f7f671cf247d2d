"""The arena: all laws on one axis, over the same work, at equal robustness."""

from feeddrive.comparison.arena import Comparison as Comparison
from feeddrive.comparison.arena import compare as compare
from feeddrive.comparison.results import write_arena as write_arena
