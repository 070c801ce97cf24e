"""Starts `authros bag follow`; the work is done by the program authros, which is installed on its own."""
