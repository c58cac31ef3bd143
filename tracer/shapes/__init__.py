"""Spheres and boxes."""
