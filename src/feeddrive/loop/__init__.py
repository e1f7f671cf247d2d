"""The loop: one sample of an axis or machine under its control, and the engine that simulates and linearizes it."""

from feeddrive.language.lazy_package import make_lazy

make_lazy(__name__)
