"""The tabs of the page, in the order of the workflow."""

from feeddrive.studio.desk import Room
from feeddrive.studio.rooms.commission import Commission
from feeddrive.studio.rooms.compare import Compare
from feeddrive.studio.rooms.export import Export
from feeddrive.studio.rooms.import_ import Import
from feeddrive.studio.rooms.optimize import Optimize
from feeddrive.studio.rooms.program import Program
from feeddrive.studio.rooms.prove import Prove
from feeddrive.studio.rooms.scope import Scope
from feeddrive.studio.rooms.tune import Tune

ROOMS: tuple[type[Room], ...] = (Import, Commission, Scope, Tune, Optimize, Compare, Prove, Program, Export)
