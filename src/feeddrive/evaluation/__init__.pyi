"""The engine under `run`, `compare`, `benchmark` and `sweep`: cases in, outcomes out, in the order of the cases."""

from feeddrive.evaluation.case import Case as Case
from feeddrive.evaluation.case import content_digest as content_digest
from feeddrive.evaluation.engine import Bar as Bar
from feeddrive.evaluation.engine import Engine as Engine
from feeddrive.evaluation.store import Folder as Folder
from feeddrive.evaluation.store import Store as Store
