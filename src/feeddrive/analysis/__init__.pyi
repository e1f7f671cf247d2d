"""Analysis of loops and signals: margins, sensitivity, stiffness, spectrum, stability, friction map."""

# written by `make stubs`

from feeddrive.analysis.contour_control import ContourGain as ContourGain
from feeddrive.analysis.contour_control import MatchedDynamics as MatchedDynamics
from feeddrive.analysis.contour_control import contour_gain as contour_gain
from feeddrive.analysis.contour_control import contour_gains as contour_gains
from feeddrive.analysis.contour_control import matched_dynamics as matched_dynamics
from feeddrive.analysis.conversion import as_frf as as_frf
from feeddrive.analysis.friction_map import FrictionMap as FrictionMap
from feeddrive.analysis.friction_map import friction_map as friction_map
from feeddrive.analysis.margins import MarginIntervals as MarginIntervals
from feeddrive.analysis.margins import Margins as Margins
from feeddrive.analysis.margins import complementary_sensitivity as complementary_sensitivity
from feeddrive.analysis.margins import coprime_margin as coprime_margin
from feeddrive.analysis.margins import margin_intervals as margin_intervals
from feeddrive.analysis.margins import margins as margins
from feeddrive.analysis.margins import sensitivity as sensitivity
from feeddrive.analysis.measured_loop import MeasuredLoop as MeasuredLoop
from feeddrive.analysis.measured_loop import measured_loop as measured_loop
from feeddrive.analysis.oscilloscope import Oscilloscope as Oscilloscope
from feeddrive.analysis.oscilloscope import Trigger as Trigger
from feeddrive.analysis.oscilloscope import readout as readout
from feeddrive.analysis.replay import Observation as Observation
from feeddrive.analysis.replay import Replay as Replay
from feeddrive.analysis.replay import observe as observe
from feeddrive.analysis.replay import replay as replay
from feeddrive.analysis.spectrum import Spectrum as Spectrum
from feeddrive.analysis.spectrum import spectrum as spectrum
from feeddrive.analysis.stability import Encirclement as Encirclement
from feeddrive.analysis.stability import Stability as Stability
from feeddrive.analysis.stability import encirclement as encirclement
from feeddrive.analysis.stability import stability as stability
from feeddrive.analysis.step_response import StepResponse as StepResponse
from feeddrive.analysis.step_response import step_response as step_response
from feeddrive.analysis.stiffness import Stiffness as Stiffness
from feeddrive.analysis.stiffness import stiffness as stiffness
