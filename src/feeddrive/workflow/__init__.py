"""Reports of a measurement: a frequency response that was estimated, an excitation that was designed."""

from feeddrive.language.lazy_package import make_lazy

make_lazy(__name__)
