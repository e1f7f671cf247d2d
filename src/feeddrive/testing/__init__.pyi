"""The battery: tests of a block that pytest collects.  Needs pytest and hypothesis: `feeddrive[testing]`."""

# written by `make stubs`

from feeddrive.testing.battery import battery as battery
