"""Pictures in bands, worked on by several processes, and PNG files."""
