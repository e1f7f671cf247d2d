"""All laws on one axis, over the same work, at equal robustness."""

from feeddrive.comparison.compare import Comparison as Comparison
from feeddrive.comparison.compare import compare_laws as compare_laws
from feeddrive.comparison.report import write_comparison as write_comparison
