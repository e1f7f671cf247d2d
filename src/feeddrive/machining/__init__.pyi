"""The machine that cuts: stability of the cut, contour error, circle test, reversal, load and surface."""

from feeddrive.machining.chatter_signs import ChatterSigns as ChatterSigns
from feeddrive.machining.chatter_signs import chatter_signs as chatter_signs
from feeddrive.machining.contour import ContourError as ContourError
from feeddrive.machining.contour import contour_error as contour_error
from feeddrive.machining.load import AxisLoad as AxisLoad
from feeddrive.machining.load import MachineLoad as MachineLoad
from feeddrive.machining.load import SpindleLoad as SpindleLoad
from feeddrive.machining.load import axis_load as axis_load
from feeddrive.machining.load import machine_load as machine_load
from feeddrive.machining.load import spindle_load as spindle_load
from feeddrive.machining.lobe_theory import ZeroOrder as ZeroOrder
from feeddrive.machining.lobe_theory import semi_discretisation as semi_discretisation
from feeddrive.machining.lobe_theory import zero_order as zero_order
from feeddrive.machining.lobes import CutStability as CutStability
from feeddrive.machining.lobes import Lobes as Lobes
from feeddrive.machining.lobes import cut_stability as cut_stability
from feeddrive.machining.lobes import stability_lobes as stability_lobes
from feeddrive.machining.regeneration import Regeneration as Regeneration
from feeddrive.machining.regeneration import arc as arc
from feeddrive.machining.regeneration import regeneration as regeneration
from feeddrive.machining.tool_point import ToolMode as ToolMode
from feeddrive.machining.tool_point import ToolPoint as ToolPoint
from feeddrive.machining.tool_point import tool_modes as tool_modes
from feeddrive.machining.tool_point import tool_point as tool_point
