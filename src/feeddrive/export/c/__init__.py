"""A routine as C99."""
