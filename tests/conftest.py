"""What holds for all tests."""

from __future__ import annotations

import os

from hypothesis import settings

# Before numpy is there: the tests share the cores already, and small matrices gain nothing by more threads.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

# No deadline: a busy machine must not fail a proof; a found counterexample prints how to run it again.  CI draws the
# same examples every time, so that a landing does not hang on the dice; everybody else draws new ones.
settings.register_profile("feeddrive", deadline=None, print_blob=True, derandomize=bool(os.environ.get("CI")))
settings.load_profile("feeddrive")
