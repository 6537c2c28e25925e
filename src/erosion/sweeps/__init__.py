"""Impacts on a grid of parameters, kept in chunks, by several processes or machines."""
