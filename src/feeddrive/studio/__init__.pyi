"""The page on which an axis is looked at and tuned: a local server, its sessions, and what it sends to a browser."""

# written by `make stubs`

from feeddrive.studio.server import Session as Session
from feeddrive.studio.server import make_app as make_app
