"""What a check ends with where it does not end well. The reasons are those of sentences.json."""


class Refused(Exception):
    """Something is contradicted."""

    def __init__(self, reason, text=""):
        super().__init__(text or reason)
        self.reason = reason


class Unproven(Refused):
    """Something that would prove it is missing; without a reason if that follows from another level."""


class Unchecked(Exception):
    """This Python cannot check it."""


class Malformed(Exception):
    """The file is not of a bundle's form."""
