"""One cable: the elastic catenary, the straight line, lengths, shapes and drums."""
