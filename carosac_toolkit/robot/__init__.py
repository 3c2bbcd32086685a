"""Robot descriptions: the value, its file, its checks and what differs from one to another."""
