"""Certificates: a loop proven stable and robust for a list of plants, in a file that anybody can check."""

from feeddrive.certificate.certificate import Certificate as Certificate
from feeddrive.certificate.certify import certify_loop as certify_loop
