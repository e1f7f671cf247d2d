"""Beltrán-Carbajal et al. 2013: active disturbance rejection on the three axes of a small mill."""

from feeddrive.papers.beltran2013.experiment import beltran2013

__all__ = ["beltran2013"]
