"""Excitation: design of a multisine for a loop, and estimation of a frequency response from the recorded run."""
