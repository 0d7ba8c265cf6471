"""Sizes that a file claims are not believed."""

from __future__ import annotations

from io import BytesIO
from itertools import product
import tracemalloc
import zlib

from lz4 import frame as lz4
from mcap.records import Chunk
import pytest
from shepherd_ros.rosbag2.errors import DamageError
from shepherd_ros.rosbag2.records import (
    contents,
    MAX_RECORD_BYTES,
    MESSAGE,
    Message,
    parse,
    PREFIX,
    read_at,
    record_at,
    unpack,
)
import zstandard

PACKERS = {'zstd': zstandard.compress, 'lz4': lz4.compress, '': bytes}


def chunk(data: bytes, kind: str, size: int, crc: int = 0) -> Chunk:
    """Return a chunk with data packed, which claims to have a size."""
    return Chunk(kind, PACKERS[kind](data), 0, 0, crc, size)


@pytest.mark.parametrize('kind', PACKERS)
def test_chunks_are_unpacked_and_checked(kind: str) -> None:
    data = bytes(range(256)) * 9000  # more than is unpacked at once
    assert unpack(chunk(data, kind, len(data), zlib.crc32(data)), 0) == data
    with pytest.raises(DamageError, match='a chunk whose checksum is wrong at byte 7'):
        unpack(chunk(data, kind, len(data), 1), 7)
    for size in (len(data) - 1, len(data) + 1, 0):
        with pytest.raises(DamageError, match=f'bytes: expected {size}'):
            unpack(chunk(data, kind, size), 0)


@pytest.mark.parametrize('kind', PACKERS)
def test_a_chunk_that_claims_too_much_is_refused_at_once(kind: str) -> None:
    for size in (MAX_RECORD_BYTES + 1, 2**40, 2**64 - 1):
        with pytest.raises(DamageError, match=f'a chunk of {size} bytes: expected at most'):
            unpack(chunk(b'x', kind, size), 0)


@pytest.mark.parametrize('kind', ['zstd', 'lz4'])
def test_a_chunk_that_unpacks_to_more_than_it_claims_takes_no_memory(kind: str) -> None:
    bomb = chunk(bytes(64 << 20), kind, 1000)
    assert len(bomb.data) < 1 << 20
    tracemalloc.start()
    with pytest.raises(DamageError, match='a chunk of 1001 bytes: expected 1000'):
        unpack(bomb, 0)
    assert tracemalloc.get_traced_memory()[1] < 1 << 20
    tracemalloc.stop()


def test_what_cannot_be_unpacked_is_refused() -> None:
    for kind, what in (
        ('zstd', 'that zstd cannot unpack'), ('lz4', 'that lz4 cannot unpack'),
        ('gzip', "packed with 'gzip'"), ('zst\0', 'packed with .zst'), ('a' * 21, f"'{'a' * 20}'"),
    ):  # fmt: skip
        with pytest.raises(DamageError, match=what):
            unpack(Chunk(kind, b'nothing of the kind', 0, 0, 0, 10), 0)


def test_records_do_not_reach_beyond_the_file() -> None:
    file = BytesIO(PREFIX.pack(5, 2**40) + bytes(100))
    with pytest.raises(DamageError, match='a record of 1099511627776 bytes, where 109 are left'):
        record_at(file, 0, 109)
    with pytest.raises(DamageError, match=f'expected at most {MAX_RECORD_BYTES}'):
        read_at(file, 0, MAX_RECORD_BYTES + 1)
    with pytest.raises(DamageError, match='the file ends after 9 of 10 bytes'):
        read_at(file, 100, 10)
    for opcode in (0, 0x10, 0x7F):
        with pytest.raises(DamageError, match=f'a record of unknown kind {opcode}'):
            record_at(BytesIO(PREFIX.pack(opcode, 0)), 0, 9)
        with pytest.raises(DamageError, match=f'a record of unknown kind {opcode} in a chunk'):
            list(contents(PREFIX.pack(opcode, 0), 0))
    for opcode in (*range(1, 0x10), 0x80, 0xFF):  # of the format, and private ones
        record = record_at(BytesIO(bytes(3) + PREFIX.pack(opcode, 2) + bytes(2)), 3, 14)
        assert (record.opcode, record.body, record.length, record.end) == (opcode, 12, 2, 14)
        if opcode not in (3, 4, 5, 12):  # schema, channel, message, metadata: read in a chunk
            assert list(contents(PREFIX.pack(opcode, 2) + bytes(2), 0)) == []


def test_bodies_that_are_too_short_are_damaged() -> None:
    for opcode, body in product([3, 4, 8, 11, 12, 13], [b'', bytes(3), b'\xff' * 40]):
        with pytest.raises(DamageError, match=r'a damaged \w+ .* at byte 5'):
            parse(opcode, body, 5)


def test_chunks_that_make_no_sense_are_damaged() -> None:
    for body in [b'', bytes(20), bytes(32) + b'\xff' * 8, b'\xff' * 60]:
        with pytest.raises(DamageError, match='Chunk'):
            parse(6, body, 0)


def test_contents_end_where_the_chunk_ends() -> None:
    empty = PREFIX.pack(5, MESSAGE.size) + MESSAGE.pack(1, 0, 5, 6)
    assert list(contents(2 * empty, 0)) == 2 * [Message(1, 5, 6, b'')]
    whole = PREFIX.pack(5, MESSAGE.size + 3) + MESSAGE.pack(1, 0, 5, 6) + b'abc'
    assert list(contents(whole + PREFIX.pack(0x90, 2) + b'xy', 0)) == [Message(1, 5, 6, b'abc')]
    for bad in (whole[:-1], whole + b'\x05', PREFIX.pack(5, 3) + bytes(3), PREFIX.pack(6, 2**50)):
        with pytest.raises(DamageError, match=r'a chunk that ends within|a message of 3 bytes'):
            list(contents(bad, 0))
    with pytest.raises(DamageError, match='a record of unknown kind 0 in a chunk'):
        list(contents(bytes(50), 0))
