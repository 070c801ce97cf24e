"""What the reader knows from another source than the bundle: trust.toml."""
import pathlib

from . import toml
from .archive import ACCOUNT, has_form, unhex
from .certificates import from_pem

LONGEST_TRUST = 65_536


class TrustError(ValueError):
    """A trust file that cannot be used."""


class Trust:
    def __init__(self, chain, persons, authorities):
        self.id, self.sealed_by_exporter = chain["id"], chain["sealed_by_exporter"]
        self.genesis, self.contract, self.code_hash = (unhex(chain[name]) for name in ("genesis", "contract", "code_hash"))
        self.signers = [unhex(one) for one in chain["signers"]]
        self.quorum = chain.get("quorum")
        self.persons = {unhex(one["account"]): one for one in persons}
        self.authorities = [(one["name"], from_pem(one["certificate"])) for one in authorities]

    def key_of(self, account):
        """The key that is pinned for an account, or None."""
        key = self.persons.get(account, {}).get("key")
        return unhex(key) if key is not None else None

    def person(self, account):
        return self.persons.get(account, {}).get("name", "")


def lists(document):
    chain, persons, authorities = document["chain"], document.get("person", []), document.get("authority", [])
    if not isinstance(chain, dict) or not all(isinstance(one, list) for one in (chain["signers"], persons, authorities)):
        raise ValueError("its tables and lists are others than those of docs/reader.md")
    if not all(isinstance(one, dict) for one in (*persons, *authorities)) or len(authorities) > 16:
        raise ValueError("a person or an authority is no table, or there are more than 16 authorities")
    return chain, persons, authorities


def check_chain(chain):
    required, optional = {"id", "genesis", "contract", "code_hash", "signers", "sealed_by_exporter"}, {"quorum"}
    if not required <= set(chain) <= required | optional:
        raise ValueError("its chain has not the lines that docs/reader.md shows")
    if not isinstance(chain["sealed_by_exporter"], bool) or type(chain["id"]) is not int or chain["id"] < 0:
        raise ValueError("sealed_by_exporter is true or false, and id a number")
    hashes = [chain["genesis"], chain["code_hash"]]
    if not all(has_form(one, ACCOUNT) for one in (*chain["signers"], chain["contract"])) or not all(has_form(one, 32) for one in hashes):
        raise ValueError("an account is 0x and 40 digits with its checksum, and a hash is 64 digits")
    signers = {unhex(one) for one in chain["signers"]}
    if len(signers) != len(chain["signers"]):
        raise ValueError("a signer is named twice")
    quorum = chain.get("quorum", 1)
    if type(quorum) is not int or ("quorum" in chain and not 1 <= quorum <= len(signers)):
        raise ValueError("its quorum is zero, or more than the number of signers")


def check_persons(persons):
    for one in persons:
        if not {"account", "name"} <= set(one) <= {"account", "name", "key"} or not isinstance(one["name"], str):
            raise ValueError("a person has an account and a name, and a key or none")
        if not has_form(one["account"], ACCOUNT) or not has_form(one.get("key", "00" * 32), 32):
            raise ValueError("a person's account is 0x and 40 digits with its checksum, and a key is 64 digits")
    if len({unhex(one["account"]) for one in persons}) != len(persons):
        raise ValueError("an account is given to two people")


def check_authorities(authorities):
    for one in authorities:
        if set(one) != {"name", "certificate"} or not all(isinstance(word, str) for word in one.values()):
            raise ValueError("an authority has a name and a certificate")


def read_trust(path):
    """The reader's own pins; what cannot be meant is refused with TrustError."""
    try:
        data = pathlib.Path(path).read_bytes()
        if len(data) > LONGEST_TRUST:
            raise ValueError("it is longer than any trust file")
        text = data.decode()
        document = toml.loads(text[1:] if text.startswith("\ufeff") else text)
        if "version" in document:
            raise ValueError("it is of a later version than this program reads; use a newer authros-verify")
        if not set(document) <= {"chain", "person", "authority"}:
            raise ValueError("it has other tables than docs/reader.md shows")
        chain, persons, authorities = lists(document)
        check_chain(chain)
        check_persons(persons)
        check_authorities(authorities)
        return Trust(chain, persons, authorities)
    except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError) as why:
        raise TrustError(f"the trust file cannot be used: {why}; docs/reader.md has an example") from None
