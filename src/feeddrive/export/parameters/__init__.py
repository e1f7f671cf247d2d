"""The target `parameters`: a P-PI design in the names and units of control makers, to be entered by hand."""
