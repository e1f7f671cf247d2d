"""Tuning of controls: optimization within robustness limits, and classical tuning rules."""

# written by `make stubs`

from feeddrive.tuning.criteria import Limits as Limits
from feeddrive.tuning.operating_point import OperatingPoint as OperatingPoint
from feeddrive.tuning.operating_point import measured_point as measured_point
from feeddrive.tuning.operating_point import modelled_point as modelled_point
from feeddrive.tuning.poles import Placement as Placement
from feeddrive.tuning.poles import placement as placement
from feeddrive.tuning.recipes import Recipe as Recipe
from feeddrive.tuning.recipes import half_antiresonance as half_antiresonance
from feeddrive.tuning.recipes import kv_rule as kv_rule
from feeddrive.tuning.recipes import makers_rule as makers_rule
from feeddrive.tuning.recipes import margin_goals as margin_goals
from feeddrive.tuning.recipes import symmetric_optimum as symmetric_optimum
from feeddrive.tuning.scaling import DelayMap as DelayMap
from feeddrive.tuning.scaling import delay_map as delay_map
from feeddrive.tuning.travel import Travel as Travel
from feeddrive.tuning.travel import TunedTravel as TunedTravel
from feeddrive.tuning.travel import along_travel as along_travel
from feeddrive.tuning.travel import frozen as frozen
from feeddrive.tuning.travel import tune_travel as tune_travel
from feeddrive.tuning.tune import Tuned as Tuned
from feeddrive.tuning.tune import assess as assess
from feeddrive.tuning.tune import tune_control as tune_control
from feeddrive.tuning.worst import OverBox as OverBox
