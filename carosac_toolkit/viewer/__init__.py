"""What `carosac view` shows in a browser: a robot at rest, a live simulation, or recorded runs."""
