"""The machine that cuts: stability of the cut, contour error, circle test, reversal, load and surface."""

from feeddrive.language.lazy_package import make_lazy

make_lazy(__name__)
