"""Certificates: a proof that a loop is stable and robust for a list of plants, in a file that anyone can check."""

from feeddrive.language.lazy_package import make_lazy

make_lazy(
    __name__,
    {
        "certificate": "Certificate",
        "box_proof": "BoxProof prove_over_box",
        "certify": "certify_loop",
        "travel_proof": "TravelProof prove_along_travel",
    },
)
