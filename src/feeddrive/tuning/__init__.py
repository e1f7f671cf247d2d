"""Gains: laws tuned under one rule, so that they can be compared."""

from feeddrive.language.lazy_package import make_lazy

make_lazy(__name__)
