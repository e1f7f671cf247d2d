"""The studio: a local web page for inspecting and tuning an axis, with its server, sessions and messages."""

# written by `make stubs`

from feeddrive.studio.server import Session as Session
from feeddrive.studio.server import make_app as make_app
