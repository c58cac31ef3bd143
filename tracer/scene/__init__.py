"""The scene: its dataclasses, the rules of the file format, and its reader and writer."""
