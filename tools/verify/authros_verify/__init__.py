"""A verifier of AuthROS evidence bundles, written from docs/format.md, sections 11 and 12, with Python's standard library alone.

    from authros_verify import verify
    verdict = verify("case.authros", "trust.toml")
    verdict.outcome     # holds, incomplete or refused
    verdict.lines()     # what `authros evidence verify` prints

It is slow, on purpose: it can be read in one sitting.
"""
from .verdict import Verdict, verify
from .trust import TrustError

__all__ = ["TrustError", "Verdict", "verify"]
