"""The studio: a local web page for inspecting and tuning an axis, with its server, sessions and messages."""

from feeddrive.language.lazy_package import make_lazy

make_lazy(
    __name__,
    {
        "server": "make_app Session",
    },
)
