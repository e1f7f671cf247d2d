"""Identification: models with standard errors from motion logs, constant-speed runs and frequency responses."""

from feeddrive.language.lazy_package import make_lazy

make_lazy(__name__)
