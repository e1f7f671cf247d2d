"""Position and force over time go in; mass, friction, dead time and the gains of a cascade come out."""
