"""Cables, platform and statics: every physical formula of the toolkit, written once."""
