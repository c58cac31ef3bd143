"""What only commands need: arguments, signals, exit statuses."""
