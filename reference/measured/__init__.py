"""Measurements: scenes to measure, timings, and charts and tables of the results."""
