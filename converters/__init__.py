"""Conversion of scenes to Mitsuba 3, and comparison of the tracer with it."""
