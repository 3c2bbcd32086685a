"""Learned controllers: environments, rewards, TD3 training and the trained policy."""

__carosac__ = True  # marks this package as ours: the name is not unique
