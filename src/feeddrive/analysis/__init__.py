"""Analysis of loops and signals: margins, sensitivity, stiffness, spectrum, stability, friction map."""

from feeddrive.language.lazy_package import make_lazy

make_lazy(__name__)
