"""Many variants of a job: what varies, the sweep, and where its rows are kept."""

from feeddrive.study.store import Manifest as Manifest
from feeddrive.study.store import Store as Store
