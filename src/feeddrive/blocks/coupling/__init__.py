"""Couplings: forces and motions that act between the axes of a machine."""
