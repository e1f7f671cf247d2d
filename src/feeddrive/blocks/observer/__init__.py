"""Observers: estimates of quantities that are not measured."""
