"""Planning of motions: from a part program to setpoints."""

# written by `make stubs`

from feeddrive.path.limits import AxisLimits as AxisLimits
from feeddrive.path.limits import MachineLimits as MachineLimits
from feeddrive.path.planned import Planned as Planned
from feeddrive.path.planned import planned_of as planned_of
from feeddrive.path.polygon import waypoints as waypoints
from feeddrive.path.program.blocks import Line as Line
from feeddrive.path.program.blocks import read_offsets as read_offsets
from feeddrive.path.program.moves import Arc as Arc
from feeddrive.path.program.moves import Begin as Begin
from feeddrive.path.program.moves import Command as Command
from feeddrive.path.program.moves import Dwell as Dwell
from feeddrive.path.program.moves import End as End
from feeddrive.path.program.moves import Feed as Feed
from feeddrive.path.program.moves import Ignored as Ignored
from feeddrive.path.program.moves import Message as Message
from feeddrive.path.program.moves import Move as Move
from feeddrive.path.program.moves import Offsets as Offsets
from feeddrive.path.program.moves import PathMode as PathMode
from feeddrive.path.program.moves import Point as Point
from feeddrive.path.program.moves import Probe as Probe
from feeddrive.path.program.moves import Spindle as Spindle
from feeddrive.path.program.moves import Spline as Spline
from feeddrive.path.program.moves import Stop as Stop
from feeddrive.path.program.moves import Straight as Straight
from feeddrive.path.program.moves import Switch as Switch
from feeddrive.path.program.moves import Synchronized as Synchronized
from feeddrive.path.program.moves import ToolChange as ToolChange
from feeddrive.path.program.moves import Wait as Wait
from feeddrive.path.program.moves import canonical_text as canonical_text
from feeddrive.path.program.reading import read_commands as read_commands
from feeddrive.path.program.reading import read_program as read_program
from feeddrive.path.program.state import Tool as Tool
from feeddrive.path.program.state import read_tools as read_tools
from feeddrive.path.setpoints import Setpoints as Setpoints
