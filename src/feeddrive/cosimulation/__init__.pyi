"""An FMU of somebody else as the plant of a loop."""

from feeddrive.cosimulation.simulate_with_fmu import simulate_with_fmu as simulate_with_fmu
