"""Studies: jobs that are run, and what they write."""
