"""From a part program to setpoints."""

from feeddrive.language.lazy_package import make_lazy

make_lazy(__name__)
