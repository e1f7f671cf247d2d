"""Tuning of controls: optimization within robustness limits, tuning rules, and iterative learning."""

from feeddrive.language.lazy_package import make_lazy

make_lazy(__name__)
