"""Files people touch: TOML in and out, measured logs, runs, result directories."""

from feeddrive.language.lazy_package import make_lazy

make_lazy(__name__)
