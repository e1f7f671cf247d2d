"""Co-simulation: an FMU from another tool as the plant of a loop."""

# written by `make stubs`

from feeddrive.cosimulation.simulate_with_fmu import simulate_with_fmu as simulate_with_fmu
