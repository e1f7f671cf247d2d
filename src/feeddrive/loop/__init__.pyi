"""The loop: one sample of an axis or machine under its control, and the engine that simulates and linearizes it."""

# written by `make stubs`

from feeddrive.loop.axis import Axis as Axis
from feeddrive.loop.box import Box as Box
from feeddrive.loop.control import Control as Control
from feeddrive.loop.frequency_response import FRF as FRF
from feeddrive.loop.gradient import Gradient as Gradient
from feeddrive.loop.gradient import gradient as gradient
from feeddrive.loop.guard import Guard as Guard
from feeddrive.loop.linearize import StateSpace as StateSpace
from feeddrive.loop.linearize import compliance as compliance
from feeddrive.loop.linearize import linearize as linearize
from feeddrive.loop.linearize import loop_gain as loop_gain
from feeddrive.loop.linearize import tracking as tracking
from feeddrive.loop.loop import Loop as Loop
from feeddrive.loop.loop import Signals as Signals
from feeddrive.loop.machine import Machine as Machine
from feeddrive.loop.simulate import Batch as Batch
from feeddrive.loop.simulate import Run as Run
from feeddrive.loop.simulate import simulate as simulate
from feeddrive.loop.simulate import simulate_batch as simulate_batch
from feeddrive.loop.simulate import stream as stream
from feeddrive.loop.simulate import stream_each as stream_each
