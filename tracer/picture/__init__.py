"""Pictures in tiles, drawn by any processes, and PNG files."""
