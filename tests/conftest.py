"""What holds for all tests."""

from __future__ import annotations

from hypothesis import settings

# no deadline: a busy machine must not fail a proof; a found counterexample prints how to run it again
settings.register_profile("feeddrive", deadline=None, print_blob=True)
settings.load_profile("feeddrive")
