"""Invalid inputs by mutation of valid ones: bytes, MCAP records, text and poses."""

import random
import struct
from dataclasses import replace

import numpy as np
import zstandard

from contact_tracker.motion.poses import Poses
from mcap_logs import records_in

ODD_NUMBERS = (0, 1, 2, 0x7F, 0x80, 0xFF, 0xFFFF, 2**31 - 1, 2**31, 2**32 - 1, 2**63, 2**64 - 1)
ODD_TEXTS = (
    *(b"nan", b"inf", b"-inf", b"1e400", b"-1", b"0", b"1e-320", b"9" * 400, b"true", b'""', b"[]", b"{}"),
    *(b'"\\u001b[31m"', b"[[1, 2], [3]]", b"1979-05-27", b"''", b"\x00", b"\xff\xfe", b"\n", b"="),
)
_HEAD = struct.Struct("<BQ")


def bytes_of(data: bytes, rng: random.Random) -> bytes:
    """Some bytes changed, removed, duplicated, or truncated."""
    changed = bytearray(data)
    for _ in range(rng.choice([1, 1, 2, 5, 30])):
        if not changed:
            break
        at = rng.randrange(len(changed))
        match rng.randrange(7):
            case 0:
                changed[at] ^= 1 << rng.randrange(8)
            case 1:
                changed[at] = rng.randrange(256)
            case 2:
                del changed[at : at + rng.choice([1, 4, 100])]
            case 3:
                changed[at:at] = changed[at : at + rng.choice([1, 8, 300])]
            case 4:
                size = rng.choice([2, 4, 8])
                number = rng.choice(ODD_NUMBERS) % 256**size
                changed[at : at + size] = number.to_bytes(size, "little")
            case 5:
                changed[at : at + 8] = struct.pack("<d", rng.choice([np.nan, np.inf, -1e308, 0.0, 5e-324]))
            case _:
                del changed[at:]
    return bytes(changed)


def records_of(data: bytes, rng: random.Random) -> bytes:
    """An MCAP file with records changed, moved, removed or duplicated, also within chunks."""
    records = [(opcode, data[begin + _HEAD.size : end]) for opcode, begin, end in records_in(data)]
    for _ in range(rng.choice([1, 1, 2, 4])):
        i = rng.randrange(len(records))
        opcode, payload = records[i]
        match rng.randrange(7):
            case 0 if len(records) > 1:
                del records[i]
            case 1:
                records.insert(rng.randrange(len(records) + 1), records[i])
            case 2:
                records[i] = (rng.choice([0, 1, 2, 3, 4, 5, 6, 7, 9, 12, 15, 16, 0x80, 255]), payload)
            case 3:
                records[i] = (opcode, bytes_of(payload, rng))
            case 4:
                rng.shuffle(records)
            case _ if opcode == 6:
                records[i] = (opcode, _chunk_of(payload, rng))
            case _:
                records[i] = (opcode, bytes_of(payload, rng))
        if not records:
            break
    tail = data[-8:] if rng.random() < 0.8 else b""
    return (
        data[:8] + b"".join(_HEAD.pack(opcode, len(payload)) + payload for opcode, payload in records) + tail
    )


def _chunk_of(payload: bytes, rng: random.Random) -> bytes:
    """A chunk with changed records, with its true or with wrong sizes."""
    try:
        begin, end, size, _, length = struct.unpack_from("<QQQII", payload)
        compression = payload[32 : 32 + length]
        packed = payload[40 + length :]
        raw = zstandard.ZstdDecompressor().decompress(packed, 2**24) if compression == b"zstd" else packed
    except (struct.error, zstandard.ZstdError, MemoryError):
        return bytes_of(payload, rng)
    raw = bytes_of(raw, rng) if rng.random() < 0.8 else raw * rng.choice([2, 50, 500])
    raw = raw[: 2**25]
    packed = zstandard.ZstdCompressor().compress(raw) if compression == b"zstd" else raw
    size = len(raw) if rng.random() < 0.7 else rng.choice(ODD_NUMBERS)
    head = struct.pack("<QQQII", begin, end, size, 0, length) + compression
    return head + struct.pack("<Q", len(packed)) + packed


def text_of(data: bytes, rng: random.Random) -> bytes:
    """A TOML or text file with lines removed, duplicated or moved, and odd values."""
    if rng.random() < 0.3:
        return bytes_of(data, rng)
    lines = data.split(b"\n")
    for _ in range(rng.choice([1, 1, 2, 5])):
        i = rng.randrange(len(lines))
        match rng.randrange(6):
            case 0:
                del lines[i]
            case 1:
                lines.insert(rng.randrange(len(lines) + 1), lines[i])
            case 2:
                lines[i] = bytes_of(lines[i], rng)
            case 3 if b"=" in lines[i]:
                key = lines[i].split(b"=")[0]
                lines[i] = key + b"= " + rng.choice(ODD_TEXTS)
            case _:
                words = lines[i].split(b" ")
                words[rng.randrange(len(words))] = rng.choice(ODD_TEXTS)
                lines[i] = b" ".join(words)
        if not lines:
            break
    return b"\n".join(lines)


def poses_of(poses: Poses, rng: random.Random) -> Poses:
    """A stream with odd numbers, stamps out of order, poses that repeat, jump or stand still."""
    stamp_ns, position_m, quat_xyzw = (column.copy() for column in poses.columns)
    for _ in range(rng.choice([1, 2, 5, 20])):
        i = rng.randrange(len(stamp_ns))
        some = slice(i, i + rng.choice([1, 3, 40]))
        match rng.randrange(8):
            case 0:
                position_m[some, rng.randrange(3)] = rng.choice([np.nan, np.inf, 1e300, 1e6, 0.0, 5e-324])
            case 1:
                quat_xyzw[some, rng.randrange(4)] = rng.choice([np.nan, np.inf, 0.0, 1e-200, -1.0])
            case 2:
                quat_xyzw[some] = 0.0
            case 3:
                stamp_ns[some] = rng.choice([0, -1, 2**62, -(2**62), int(stamp_ns[0])])
            case 4:
                stamp_ns[i:] += rng.choice([-(10**9), 10**6, 10**9, 10**13, 10**17])
            case 5:
                position_m[some] = position_m[i]
                quat_xyzw[some] = quat_xyzw[i]
            case 6:
                quat_xyzw[some] *= -1.0
            case _:
                position_m[some] += rng.choice([1e-6, 0.1, 1e3])
    order = np.arange(len(stamp_ns))
    if rng.random() < 0.2:
        rng.shuffle(order)
    return replace(poses, stamp_ns=stamp_ns[order], position_m=position_m[order], quat_xyzw=quat_xyzw[order])
