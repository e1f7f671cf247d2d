"""What each command does, as a function with a declared request; `command.py` lists them, one module each."""

from feeddrive.language.lazy_package import make_lazy

make_lazy(__name__)
