"""The catalogue of figures of merit for loops, runs and machines, with the goals and limits of a tuning."""

# written by `make stubs`

from feeddrive.figures.catalogue import figure as figure
from feeddrive.figures.catalogue import figures as figures
from feeddrive.figures.catalogue import goals as goals
from feeddrive.figures.catalogue import limitable as limitable
from feeddrive.figures.figure import Figure as Figure
from feeddrive.figures.figure import Goal as Goal
from feeddrive.figures.figure import Limit as Limit
from feeddrive.figures.figure import Limitable as Limitable
from feeddrive.figures.figure import Statistics as Statistics
from feeddrive.figures.of_loops import LinearLoop as LinearLoop
from feeddrive.figures.slopes import Slope as Slope
