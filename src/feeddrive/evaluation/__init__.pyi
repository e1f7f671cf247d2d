"""Evaluation of cases in this process, on all cores or on a Dask cluster; an evaluation can be stopped and resumed."""

# written by `make stubs`

from feeddrive.evaluation.case import Case as Case
from feeddrive.evaluation.case import content_digest as content_digest
from feeddrive.evaluation.designs import Designs as Designs
from feeddrive.evaluation.engine import Bar as Bar
from feeddrive.evaluation.engine import Engine as Engine
from feeddrive.evaluation.robustness import Design as Design
from feeddrive.evaluation.robustness import Rule as Rule
from feeddrive.evaluation.scheduler import Certificates as Certificates
from feeddrive.evaluation.store import Folder as Folder
from feeddrive.evaluation.store import Store as Store
