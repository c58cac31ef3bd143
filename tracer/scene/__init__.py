"""The scene: its dataclasses, what may stand in a file, and how a file is read."""
