"""Analysis of loops and signals: margins, sensitivity, stiffness, spectrum, stability, friction map."""

from feeddrive.analysis.conversion import as_frf as as_frf
from feeddrive.analysis.friction_map import FrictionMap as FrictionMap
from feeddrive.analysis.friction_map import friction_map as friction_map
from feeddrive.analysis.margin_intervals import MarginIntervals as MarginIntervals
from feeddrive.analysis.margin_intervals import margin_intervals as margin_intervals
from feeddrive.analysis.margins import Margins as Margins
from feeddrive.analysis.margins import complementary_sensitivity as complementary_sensitivity
from feeddrive.analysis.margins import margins as margins
from feeddrive.analysis.margins import sensitivity as sensitivity
from feeddrive.analysis.measured_loop import MeasuredLoop as MeasuredLoop
from feeddrive.analysis.measured_loop import measured_loop as measured_loop
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
from feeddrive.analysis.stiffness import Stiffness as Stiffness
from feeddrive.analysis.stiffness import stiffness as stiffness
