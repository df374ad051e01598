"""The index of a recording: byte for byte MCAP's own records, and next to nothing in memory until then."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st
from mcap.records import ChunkIndex

from formation.monitor.recording.part import BLOCK_BYTES, Entry, Index, packed

HEAD = 56
TIMES = st.integers(0, 2**62)
ENTRIES = st.builds(
    Entry,
    start=TIMES,
    end=TIMES,
    offset=TIMES,
    length=st.integers(HEAD + 100, 2**40),
    unpacked=TIMES,
    codec=st.sampled_from(["lz4", "zstd", ""]),
    lengths=st.dictionaries(st.integers(0, 2**16 - 1), st.integers(15, 2**32 - 1), max_size=20),
)


@given(st.lists(ENTRIES, max_size=10))
def test_index_records_equal_mcap_chunk_index(entries: list[Entry]) -> None:
    index, expected = Index(HEAD), b""
    for one in entries:
        index.add(one)
        places, at = {}, one.offset + one.length
        for channel, length in one.lengths.items():
            places[channel] = at
            at += length
        expected += packed(
            ChunkIndex(
                message_start_time=one.start,
                message_end_time=one.end,
                chunk_start_offset=one.offset,
                chunk_length=one.length,
                message_index_offsets=places,
                message_index_length=sum(one.lengths.values()),
                compression=one.codec,
                compressed_size=one.length - HEAD - len(one.codec),
                uncompressed_size=one.unpacked,
            )
        )
    assert index.records() == expected
    assert (index.count, index.size) == (len(entries), len(expected))


def test_index_memory_is_a_twentieth_of_file_size() -> None:
    index = Index(HEAD)
    for number in range(5000):
        start = 10**18 + number * 500_000_000
        lengths = {channel: 15 + 16 * (5 + (number + channel) % 2) for channel in range(1, 80)}
        index.add(Entry(start, start + 499_000_000, number * 60_000, 30_000, 80_000, "lz4", lengths))
    assert index.size == len(index.records())
    assert sum(map(len, index._packed)) < index.size / 20
    assert len(index._newest) < BLOCK_BYTES
