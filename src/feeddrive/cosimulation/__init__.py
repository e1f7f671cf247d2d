"""An FMU of somebody else as the plant of a loop."""

from feeddrive.language.lazy_package import make_lazy

make_lazy(__name__)
