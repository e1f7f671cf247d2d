"""Conversion of the segments of a part program to a path that is C3 in its parameter, within the programmed
tolerance.
"""
