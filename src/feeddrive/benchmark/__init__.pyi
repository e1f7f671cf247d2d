"""The benchmark of control laws: fixed plants, versioned rules, stored designs, one table."""

# written by `make stubs`

from feeddrive.benchmark.benchmark import Benchmark as Benchmark
from feeddrive.benchmark.benchmark import score as score
from feeddrive.benchmark.benchmark import search as search
from feeddrive.benchmark.rules import Plant as Plant
from feeddrive.benchmark.rules import Rules as Rules
from feeddrive.benchmark.rules import read_rules as read_rules
