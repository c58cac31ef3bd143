"""Render pictures in tiles, in one or several processes, and write picture files."""
