"""Running one robot live: what it follows, what is shown meanwhile, and how a run ends."""
