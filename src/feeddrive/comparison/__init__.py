"""All laws on one axis, over the same work, at equal robustness."""

from feeddrive.language.lazy_package import make_lazy

make_lazy(__name__)
