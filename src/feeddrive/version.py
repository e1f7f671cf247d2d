"""The version of feeddrive, which every room may import; the package itself imports the rooms."""

__version__ = "0.1.0"
