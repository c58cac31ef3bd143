"""Pixels that edges cross."""
