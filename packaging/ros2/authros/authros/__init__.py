"""Starts the program authros, which is installed by its own package."""
