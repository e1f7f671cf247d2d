"""Studies: many variants of a job, computed on the cores of this machine or on a cluster, and their statistics."""

# written by `make stubs`

from feeddrive.study.answers import Answers as Answers
from feeddrive.study.answers import answers_of as answers_of
from feeddrive.study.chunk import run_chunk as run_chunk
from feeddrive.study.page import write_report as write_report
from feeddrive.study.robust import Robust as Robust
from feeddrive.study.robust import tune_robust as tune_robust
from feeddrive.study.store import Manifest as Manifest
from feeddrive.study.store import Store as Store
from feeddrive.study.study import Bound as Bound
from feeddrive.study.study import Study as Study
from feeddrive.study.study import read_study as read_study
from feeddrive.study.sweep import Sweep as Sweep
from feeddrive.study.variants import VariantGroup as VariantGroup
from feeddrive.study.variants import Variants as Variants
from feeddrive.study.variants import variant_groups as variant_groups
from feeddrive.study.variants import variants as variants
