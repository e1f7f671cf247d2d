"""The page on which an axis is looked at and tuned: a local server, its sessions, and what it sends to a browser."""

from feeddrive.language.lazy_package import make_lazy

make_lazy(
    __name__,
    {
        "server": "make_app Session",
    },
)
