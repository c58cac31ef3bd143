"""Conversion of scenes to Mitsuba 3."""
