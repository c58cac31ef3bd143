"""Tools for commands: arguments, failures, progress, signals and exit statuses."""
