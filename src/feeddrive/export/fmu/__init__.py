"""A controller or a plant as an FMU: a component for simulation tools, by the standards FMI 2.0 and 3.0."""
