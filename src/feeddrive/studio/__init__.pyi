"""A local page for one axis."""

from feeddrive.studio.server import make_app as make_app
from feeddrive.studio.session import Session as Session
