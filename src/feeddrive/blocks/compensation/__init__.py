"""What goes beside any law: disturbance rejection, structural modes."""
