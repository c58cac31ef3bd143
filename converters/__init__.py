"""Conversion of scenes to Mitsuba 3, and its pictures of them."""
