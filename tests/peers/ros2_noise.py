"""Sends datagrams that are no RTPS, or nearly, to the ports of domain 0 on loopback: ros2_noise.py COUNT"""

import random
import socket
import struct
import sys

PORTS = [7400, 7401, 7410, 7411, 7412, 7413]


def datagram(random):
    kind = random.randrange(5)
    if kind == 0:
        return random.randbytes(random.randrange(0, 1400))
    header = b"RTPS" + bytes([2, random.randrange(6)]) + random.randbytes(2) + random.randbytes(12)
    if kind == 1:
        return header[: random.randrange(len(header))]
    body = b""
    for _ in range(random.randrange(1, 6)):
        # Kinds of submessages: DATA, DATA_FRAG, HEARTBEAT, GAP, INFO_TS, ACKNACK and an invalid one.
        which = random.choice([0x15, 0x16, 0x07, 0x08, 0x09, 0x06, 0x0E, random.randrange(256)])
        content = random.randbytes(random.randrange(0, 200))
        claim = len(content) if kind == 2 else random.choice([0, 1, 0xFFFF, len(content) + 4])
        body += struct.pack("<BBH", which, random.randrange(256), claim) + content
    if kind == 4:
        # A fragment of a sample of four gigabytes.
        content = struct.pack("<HH8sqIHHI", 0, 28, bytes([0, 0, 1, 0xC7, 0, 0, 1, 0xC2]), 1, 1, 1, 1024, 0xFFFFFFFF)
        body = struct.pack("<BBH", 0x16, 1, len(content) + 64) + content + random.randbytes(64)
    return header + body


def main():
    numbers = random.Random(7)
    out = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    count = int(sys.argv[1])
    for _ in range(count):
        try:
            out.sendto(datagram(numbers), ("127.0.0.1", numbers.choice(PORTS)))
        except OSError:
            # Nobody listens on this port.
            pass
    print(count)


if __name__ == "__main__":
    main()
