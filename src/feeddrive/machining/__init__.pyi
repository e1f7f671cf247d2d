"""The machine that cuts: stability of the cut, contour error, circle test, reversal, load and surface."""

from feeddrive.machining.contour import ContourError as ContourError
from feeddrive.machining.contour import contour_error as contour_error
from feeddrive.machining.load import AxisLoad as AxisLoad
from feeddrive.machining.load import MachineLoad as MachineLoad
from feeddrive.machining.load import SpindleLoad as SpindleLoad
from feeddrive.machining.load import axis_load as axis_load
from feeddrive.machining.load import machine_load as machine_load
from feeddrive.machining.load import spindle_load as spindle_load
