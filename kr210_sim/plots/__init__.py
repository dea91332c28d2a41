"""Plots of a run, drawn from its records alone and returned as SVG."""
