"""Certificates: a proof that a loop is stable and robust for a list of plants, in a file that anyone can check."""

# written by `make stubs`

from feeddrive.certificate.box_proof import BoxProof as BoxProof
from feeddrive.certificate.box_proof import prove_over_box as prove_over_box
from feeddrive.certificate.certificate import Certificate as Certificate
from feeddrive.certificate.certify import certify_loop as certify_loop
from feeddrive.certificate.travel_proof import TravelProof as TravelProof
from feeddrive.certificate.travel_proof import prove_along_travel as prove_along_travel
