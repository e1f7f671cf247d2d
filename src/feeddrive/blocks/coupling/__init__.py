"""What acts between the axes of a machine."""
