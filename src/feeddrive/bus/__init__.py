"""Drives on a field bus by CiA 402: what to send, what comes back, and a virtual drive to try it on."""

from feeddrive.language.lazy_package import make_lazy

make_lazy(__name__)
