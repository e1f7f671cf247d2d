"""The analysis of the rows of a sweep: yield, worst cases, sensitivity, bands and Pareto fronts, and its report."""
