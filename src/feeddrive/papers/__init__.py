"""The experiments that reproduce the four papers, each with a table of claims."""
