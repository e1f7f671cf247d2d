"""Compensations that can be combined with any law: disturbance rejection, structural modes."""
