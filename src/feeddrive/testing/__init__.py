"""The battery: tests of a block that pytest collects.  Needs pytest and hypothesis: `feeddrive[testing]`."""

import sys

from feeddrive.language.lazy_package import make_lazy

if "pytest" in sys.modules:  # its failed rows show the values that differ
    sys.modules["pytest"].register_assert_rewrite(f"{__name__}.battery")
make_lazy(
    __name__,
    {
        "battery": "battery",
    },
)
