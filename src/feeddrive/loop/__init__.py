"""Floor 2, the loop: one sample of one axis, and the engine that runs, linearises and differentiates it."""

from feeddrive.language.lazy_package import make_lazy

make_lazy(__name__)
