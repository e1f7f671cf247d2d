"""The battery of a block: rows that pytest collects."""

from feeddrive.testing.battery import battery as battery
