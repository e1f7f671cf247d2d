"""Commissioning: the motions of an unknown drive, what they tell, and the trial of a new control."""

# written by `make stubs`

from feeddrive.commissioning.evidence import Evidence as Evidence
from feeddrive.commissioning.evidence import Modelled as Modelled
from feeddrive.commissioning.evidence import read_evidence as read_evidence
from feeddrive.commissioning.motions import Pace as Pace
from feeddrive.commissioning.motions import push as push
from feeddrive.commissioning.motions import strokes as strokes
from feeddrive.commissioning.motions import trial as trial
from feeddrive.commissioning.record import Commissioned as Commissioned
from feeddrive.commissioning.record import Step as Step
from feeddrive.commissioning.record import read_commissioned as read_commissioned
from feeddrive.commissioning.trial import Figures as Figures
from feeddrive.commissioning.trial import Trial as Trial
from feeddrive.commissioning.trial import figures as figures
from feeddrive.commissioning.trial import predicted as predicted
