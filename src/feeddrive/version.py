"""The version of feeddrive. Every package may import this module; `feeddrive` itself imports all packages."""

__version__ = "0.1.0"
