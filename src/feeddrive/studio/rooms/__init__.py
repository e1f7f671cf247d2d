"""The tabs of the page, in the order of the workflow."""

from feeddrive.studio.desk import Room
from feeddrive.studio.rooms.bring import Bring
from feeddrive.studio.rooms.commission import Commission
from feeddrive.studio.rooms.compare import Compare
from feeddrive.studio.rooms.goal import Goal
from feeddrive.studio.rooms.program import Program
from feeddrive.studio.rooms.prove import Prove
from feeddrive.studio.rooms.scope import Scope
from feeddrive.studio.rooms.take import Take
from feeddrive.studio.rooms.tune import Tune

ROOMS: tuple[type[Room], ...] = (Bring, Commission, Scope, Tune, Goal, Compare, Prove, Program, Take)
