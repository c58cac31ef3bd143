"""The tracer measured, and held against others; a module with a `main` is a command."""
