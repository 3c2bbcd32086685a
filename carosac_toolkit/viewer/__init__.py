"""Browser view of `carosac view`: a robot at rest, a live simulation, or recorded runs."""
