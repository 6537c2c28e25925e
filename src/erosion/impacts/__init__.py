"""Impacts: one or many, followed by steps, and the angle at which most is removed."""
