"""Who sealed a block: Clique (EIP-225), QBFT and IBFT 2.0."""
from .curves import recover
from .errors import Refused
from .hashes import keccak
from .state import encode, number, rlp

MIX = b"ctical byzantine fault tolerance"
ROUNDS_TRIED = 16


def two_thirds(count):
    return -(-2 * count // 3)


class Seals:
    """The pinned who sealed a block, the first who is not pinned, and whether the block itself has no seal that is checked."""

    def __init__(self, in_header=False):
        self.pinned, self.stranger, self.is_unsigned, self.in_header = set(), None, False, in_header


class Committed:
    """The extra data of QBFT and IBFT 2.0: vanity, validators, vote, round, seals."""

    def __init__(self, header, extra, is_ibft):
        self.header, self.extra, self.is_ibft = header, extra, is_ibft
        self.named, self.sealed, self.round = extra[1], extra[4], int.from_bytes(extra[3], "big")

    @classmethod
    def of(cls, header):
        if header[13] != MIX or number(header[8]) == 0:
            return None
        try:
            extra = rlp(header[12])
        except ValueError:
            return None
        is_text = lambda one, length: isinstance(one, bytes) and len(one) == length
        if not isinstance(extra, list) or len(extra) != 5 or not is_text(extra[0], 32) or not isinstance(extra[3], bytes):
            return None
        if not isinstance(extra[1], list) or not isinstance(extra[4], list):
            return None
        if not all(is_text(one, 20) for one in extra[1]) or not all(is_text(one, 65) for one in extra[4]):
            return None
        if len(extra[3]) == 4 and extra[3][0] == 0 and extra[2] != []:
            return cls(header, extra, True)
        if len(extra[3]) <= 3 and extra[3][:1] != b"\0" and isinstance(extra[2], list):
            return cls(header, extra, False)
        return None

    def signed(self, round_):
        length = 4 if self.is_ibft else (round_.bit_length() + 7) // 8
        unsealed = [*self.extra[:3], round_.to_bytes(length, "big")] + ([] if self.is_ibft else [[]])
        return keccak(encode(self.header[:12] + [encode(unsealed)] + self.header[13:]))

    def is_of_another_round(self, seal, accounts):
        rounds = (one for one in range(ROUNDS_TRIED + 1) if one != self.round)
        return any(recover(self.signed(one), seal) in accounts for one in rounds)

    def seals(self, pinned):
        found, hash_, everyone = Seals(True), self.signed(self.round), []
        for seal in self.sealed:
            sealer = recover(hash_, seal)
            if sealer is None or (self.named and sealer not in self.named):
                raise Refused("broken_seals", "a seal in the header is of another round, or of no validator that it names")
            if sealer in everyone:
                raise Refused("broken_seals", "one has sealed the header twice")
            everyone.append(sealer)
        if len(everyone) < two_thirds(len(self.named)):
            raise Refused("broken_seals", "too few of the validators that the header names have sealed it")
        found.pinned = set(everyone) & pinned
        found.stranger = min((one for one in everyone if one not in pinned), default=None)
        if self.sealed and not self.named and not found.pinned and self.is_of_another_round(self.sealed[0], pinned):
            raise Refused("broken_seals", "a seal in the header is of another round")
        return found


def clique_sealer(header):
    """None under another consensus: it has a different mix hash, or no whole addresses between vanity and seal."""
    extra = header[12]
    if header[13] != bytes(32) or len(extra) < 97 or (len(extra) - 97) % 20:
        return None
    bare = header[:12] + [extra[:-65]] + header[13:]
    return recover(keccak(encode(bare)), extra[-65:])


def seals(headers, first, pinned):
    """Of the block itself, or under Clique also of those who built on it, until all pinned are met."""
    committed = Committed.of(rlp(headers[first]))
    if committed:
        return committed.seals(pinned)
    found, parent = Seals(), None
    for at in range(first, first + 4 * len(pinned) + 16):
        if at not in headers:
            break
        header = rlp(headers[at])
        if parent is not None and header[0] != parent:
            break
        sealer = clique_sealer(header)
        if sealer not in pinned:
            found.stranger, found.is_unsigned = sealer, sealer is None and at == first
            break
        found.pinned.add(sealer)
        if len(found.pinned) == len(pinned):
            break
        parent = keccak(headers[at])
    return found
