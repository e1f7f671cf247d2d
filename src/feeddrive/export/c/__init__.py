"""Export of a routine as C99."""
