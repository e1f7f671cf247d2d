"""A loop goes in and a multisine comes out; the log of its run goes in and a frequency response comes out."""
