"""Messages as they are packed: LZ4 in its block format, and matrices (crates/gateway/src/PROTOCOL.md, section 9)."""
import struct
import zlib

from .errors import Refused

LARGEST_MESSAGE = 64 * 2 ** 20
MOST_PER_MATRIX_BYTE = 1100


def broken(text):
    return Refused("bad_disclosure", text)


def lz4(packed, plain_length):
    if not len(packed) < plain_length <= LARGEST_MESSAGE or plain_length // 255 > len(packed):
        raise broken("the message has another length")
    out, at = bytearray(), 0

    def more(length):  # 15 in the token continues in bytes, 255 in a byte continues in the next
        nonlocal at
        goes_on = length == 15
        while goes_on:
            length, goes_on, at = length + packed[at], packed[at] == 255, at + 1
        return length

    try:
        while True:
            token, at = packed[at], at + 1
            literals = more(token >> 4)
            if literals > len(packed) - at or literals > plain_length - len(out):
                raise broken("the packed message is cut off, or longer than it says")
            out += packed[at:at + literals]
            at += literals
            if at == len(packed):
                break
            back, at = packed[at] | packed[at + 1] << 8, at + 2
            length = more(token & 15) + 4
            if not 0 < back <= len(out) or length > plain_length - len(out):
                raise broken("the packed message points to where nothing is, or is longer than it says")
            piece = bytes(out[-back:])
            out += (piece * (length // back + 1))[:length]
    except IndexError:
        raise broken("the packed message is cut off") from None
    if len(out) != plain_length:
        raise broken("the message has another length")
    return bytes(out)


def paeth(left, above, corner):
    a, b, c = abs(above - corner), abs(left - corner), abs(left + above - 2 * corner)
    return left if a <= b and a <= c else above if b <= c else corner


def bytes_of_row(kind, row, above, back):
    """Undoes a filter of PNG."""
    if kind > 4:
        raise broken("a row has an unknown filter")
    row = bytearray(row)
    if kind == 2:
        return bytearray((one + up) & 255 for one, up in zip(row, above))
    if kind == 1:
        for at in range(back, len(row)):
            row[at] = (row[at] + row[at - back]) & 255
    elif kind == 3:
        for at in range(len(row)):
            row[at] = (row[at] + ((row[at - back] if at >= back else 0) + above[at]) // 2) & 255
    elif kind == 4:
        for at in range(len(row)):
            guess = paeth(row[at - back], above[at], above[at - back]) if at >= back else above[at]
            row[at] = (row[at] + guess) & 255
    return row


def numbers_of_row(kind, row, above, back, sample):
    """Undoes the filter of wider numbers, whose bytes are in planes."""
    if kind not in (1, 2):
        raise broken("a row has an unknown filter")
    width, mask, now = len(row) // sample, (1 << 8 * sample) - 1, []
    for at in range(width):
        folded = int.from_bytes(row[at::width], "little")
        difference = -(folded >> 1) - 1 if folded & 1 else folded >> 1
        before = above[at] if kind == 2 else now[at - back] if at >= back else 0
        now.append((before + difference) & mask)
    return now


def inflated(stream, length):
    coder = zlib.decompressobj()
    try:
        out = coder.decompress(stream, length + 1)
        out += coder.flush(1) if coder.eof else b""
    except zlib.error:
        raise broken("the packed matrix is damaged") from None
    if len(out) != length or not coder.eof or coder.unused_data or coder.unconsumed_tail:
        raise broken("the packed matrix is damaged")
    return out


def matrix(packed, plain_length):
    if not len(packed) < plain_length <= LARGEST_MESSAGE or len(packed) < 15:
        raise broken("the message has another length")
    start, rows, columns, channels, how, apart = struct.unpack(">3I3B", packed[:15])
    sample, is_big, is_green = how & 0x3F, how & 0x80, how & 0x40
    row = columns * channels * sample
    end = start + rows * row
    if sample not in (1, 2, 4) or not 1 <= channels <= 64 or apart not in (1, 2) or row < 16 or end > plain_length:
        raise broken("the packed matrix has another shape than its message")
    behind = 15 + start + plain_length - end
    if (is_green and (sample != 1 or channels < 3)) or behind > len(packed) or plain_length // MOST_PER_MATRIX_BYTE > len(packed):
        raise broken("the packed matrix is damaged")
    plain = inflated(packed[behind:], rows * (row + 1))
    out, back = [packed[15:15 + start]], apart * channels
    rows_above = [bytearray(row) if sample == 1 else [0] * (row // sample)] * 2
    for at in range(0, len(plain), row + 1):
        kind, coded, above = plain[at], plain[at + 1:at + 1 + row], rows_above[-apart]
        now = bytes_of_row(kind, coded, above, back) if sample == 1 else numbers_of_row(kind, coded, above, back, sample)
        rows_above = [rows_above[1], now]
        out.append(written(now, sample, is_big, channels if is_green else 0))
    return b"".join(out) + packed[15 + start:behind]


def written(row, sample, is_big, colours):
    if sample > 1:
        return b"".join(one.to_bytes(sample, "big" if is_big else "little") for one in row)
    if colours:
        row = bytearray(row)
        for at in range(0, len(row) - colours + 1, colours):
            for colour in (at, at + 2):
                row[colour] = (row[colour] + row[at + 1]) & 255
    return bytes(row)


def unpacked(how, body, plain_length):
    return lz4(body, plain_length) if how == 1 else matrix(body, plain_length) if how == 2 else body
