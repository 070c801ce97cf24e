"""What tools/verify says of bundles: `judge.py < CASES`, a list of {"bundle": PATH, "trust": PATH or null} as JSON. It answers with the
list of what `--json` has of each, or {"trust": WHY} where the trust file cannot be used. The page's judge.js does the same."""
import json
import pathlib
import sys

sys.dont_write_bytecode = True
sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[2] / "tools" / "verify"))

from authros_verify import TrustError, verify  # noqa: E402


def judged(bundle, trust):
    try:
        return verify(bundle, trust).document()
    except TrustError as why:
        return {"trust": str(why)}


print(json.dumps([judged(case["bundle"], case["trust"]) for case in json.load(sys.stdin)]))
