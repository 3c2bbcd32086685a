"""Arrays, errors, files and other tools that know nothing of robots."""
