"""A study of eight rows or fewer, for tests of what evaluates it."""

TEXT = """
title = "Small"
machine = "ball_screw"
count = {count}
chunk = {chunk}
seed = 3
measure = [{measure}]

[reference]
kind = "snap_limited_move"
distance_mm = 1
velocity = 0.1
acceleration = 5
jerk = 800
snap = 2e5

[[vary]]
parameter = "axis.x.plant.mass_load"
tolerance_percent = 20
"""


def small_study(count: int, chunk: int, measure: str = '"sensitivity_peak"') -> str:
    """Return the text of a study with so many rows."""
    return TEXT.format(count=count, chunk=chunk, measure=measure)
