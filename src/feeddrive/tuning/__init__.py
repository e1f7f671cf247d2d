"""Gains: tuned, by rules, learned; and the laws that can be tuned."""

from feeddrive.language.lazy_package import make_lazy

make_lazy(__name__)
