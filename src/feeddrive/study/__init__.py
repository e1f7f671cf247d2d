"""Studies: many variants of a job, swept on the cores of this machine or on a cluster, and what follows from them."""

from feeddrive.language.lazy_package import make_lazy

make_lazy(__name__)
