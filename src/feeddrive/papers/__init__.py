"""The experiments of the four papers, each with a table of its claims."""
