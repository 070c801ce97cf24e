"""Transactions signed and read by eth-account. A file of JSON {what, transactions} names the work; the answer is a JSON list.

tests/support/foreign.rs runs it. `sign`: signs each with its `secret`; answers its raw bytes, hash and account. `read`: encodes
each as a node's `eth_getTransactionByHash` lists it; answers the hash and the account that signed it.
"""

import json
import sys

import rlp
from eth_account import Account
from eth_utils import keccak


def signed(transaction: dict) -> dict:
    secret = transaction.pop("secret")
    done = Account.sign_transaction(transaction, secret)
    account = Account.from_key(secret).address.lower()
    return {"raw": "0x" + done.raw_transaction.hex(), "hash": "0x" + done.hash.hex(), "account": account}


def encoded(listed: dict) -> bytes:
    if listed["type"] != "0x0":
        raise ValueError(f"an envelope of type {listed['type']}")

    def data(name: str) -> bytes:
        return bytes.fromhex((listed[name] or "0x")[2:])

    def number(name: str) -> int:
        return int(listed[name], 16)

    before = [number(name) for name in ("nonce", "gasPrice", "gas")]
    return rlp.encode([*before, data("to"), number("value"), data("input"), *(number(name) for name in "vrs")])


def read(listed: dict) -> dict:
    raw = encoded(listed)
    return {"hash": "0x" + keccak(raw).hex(), "account": Account.recover_transaction(raw).lower()}


def main() -> None:
    with open(sys.argv[1], encoding="utf-8") as file:
        request = json.load(file)
    work = {"sign": signed, "read": read}[request["what"]]
    print(json.dumps([work(one) for one in request["transactions"]]))


main()
