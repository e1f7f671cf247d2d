"""User files: machine and job files in TOML, measured logs, recorded runs, result directories."""

from feeddrive.language.lazy_package import make_lazy

make_lazy(__name__)
