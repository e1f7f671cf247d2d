"""The machine that cuts: stability of the cut, contour error, circle test, reversal, load and surface."""

from feeddrive.machining.contour import ContourError as ContourError
from feeddrive.machining.contour import contour_error as contour_error
