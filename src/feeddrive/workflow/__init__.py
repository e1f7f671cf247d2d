"""The commands as functions with declared requests, one module each; `command.py` lists them."""

from feeddrive.language.lazy_package import make_lazy

make_lazy(__name__)
