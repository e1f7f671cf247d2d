"""Certificates: a loop proven stable and robust for a list of plants, in a file that anybody can check."""
