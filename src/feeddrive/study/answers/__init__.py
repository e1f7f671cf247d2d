"""What the rows of a sweep say: yield, worst cases, what decides, bands and fronts, and the page with all of it."""
