"""The target `parameters`: a P-PI design in the names and units of the makers of controls, as text for a person."""
