"""From measurements to models: motion logs, constant-speed runs and frequency responses, each with honest errors."""

from feeddrive.language.lazy_package import make_lazy

make_lazy(__name__)
