from __future__ import annotations

import argparse
import shutil
from pathlib import Path

import pytest
from mcap.reader import make_reader

from formation.monitor.recording.reader import UnreadableError, about_of, read
from formation.monitor.recording.recover import recover
from formation.monitor.recording.rotation import Rotation, of_size, of_time, siblings
from tests.support.child import until
from tests.support.monitored import EPOCH, Fleet
from tests.support.recordings import has_end
from tests.unit.monitor.recording.test_recorder import recorder

ROTATION = Rotation(time=2.0)


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, ...]:
    """Record eleven seconds of a fleet in parts of two seconds."""
    with recorder(tmp_path_factory.mktemp("recorded") / "run.mcap", rotation=ROTATION) as recording:
        for sample in Fleet().positions(10.0, 21.0):
            recording.write(sample, sample.arrived + EPOCH)
            recording.flush(sample.arrived)
    assert recording.failure is None
    assert sum(recording.recorded.values()) == len(Fleet().positions(10.0, 21.0))
    return recording.paths


@pytest.fixture
def parts(recorded: tuple[Path, ...], tmp_path: Path) -> tuple[Path, ...]:
    """Copy the parts of a recording, which a test may change."""
    return tuple(Path(shutil.copy(path, tmp_path)) for path in recorded)


def test_parts_are_numbered_and_each_is_a_complete_file(parts: tuple[Path, ...]) -> None:
    assert [path.name for path in parts] == ["run.mcap", *(f"run-{n}.mcap" for n in range(2, len(parts) + 1))]
    assert 4 <= len(parts) <= 6
    topics = set()
    for path in parts:
        with path.open("rb") as stream:
            reader = make_reader(stream, validate_crcs=True)
            summary = reader.get_summary()
            assert reader.get_header().profile == "ros2"
            assert len(list(reader.iter_metadata())) == 1
            assert summary is not None
            assert summary.statistics is not None
            assert summary.statistics.message_count == len(list(reader.iter_messages())) > 0
            assert {one.schema_id for one in summary.channels.values()} <= set(summary.schemas)
            topics.add(frozenset(one.topic for one in summary.channels.values()))
    assert len(topics) == 1


def test_part_metadata_names_its_number_and_previous_part(parts: tuple[Path, ...]) -> None:
    result = [about_of(path) for path in parts]
    assert [one["part"] for one in result] == [str(n + 1) for n in range(len(parts))]
    assert [one["previous"] for one in result] == ["", *(path.name for path in parts[:-1])]
    assert len({one["recording"] for one in result}) == 1


@pytest.mark.parametrize("which", [0, 1, -1])
def test_any_part_opens_the_complete_recording(parts: tuple[Path, ...], which: int) -> None:
    recording = read(parts[which])
    samples = Fleet().positions(10.0, 21.0)
    assert recording.parts == parts
    assert [one.sample[:3] for one in recording.messages()] == [one[:3] for one in samples]
    extent = recording.extent()
    assert extent.counts.total() == len(samples)
    assert (extent.start, extent.end) == pytest.approx(
        (EPOCH + samples[0].arrived, EPOCH + samples[-1].arrived)
    )
    assert not recording.condition().is_cut


def test_sequence_numbers_continue_in_next_part(parts: tuple[Path, ...]) -> None:
    numbers: dict[str, list[int]] = {}
    for path in parts:
        with path.open("rb") as stream:
            for _, channel, message in make_reader(stream).iter_messages():
                numbers.setdefault(channel.topic, []).append(message.sequence)
    for topic, found in numbers.items():
        assert found == list(range(1, len(found) + 1)), topic


def test_truncated_or_missing_parts_leave_the_others_readable(parts: tuple[Path, ...]) -> None:
    parts[-1].write_bytes(parts[-1].read_bytes()[:-200])
    parts[1].unlink()
    recording = read(parts[0])
    assert recording.parts == (parts[0], *parts[2:])
    assert recording.condition().is_cut
    assert recording.extent().counts.total() == len(list(recording.messages()))


def test_recovered_copy_of_part_is_not_another_part(parts: tuple[Path, ...]) -> None:
    parts[-1].write_bytes(parts[-1].read_bytes()[:-200])
    out = parts[-1].with_name(f"{parts[-1].stem}-recovered.mcap")
    recover(parts[-1], out)
    assert has_end(out)
    assert read(parts[0]).parts == parts


def test_recordings_with_similar_names_stay_separate(tmp_path: Path) -> None:
    names = ["day-101500.mcap", "day-101501.mcap", "day.mcap", "day-2.mcap"]
    for name in names:
        with recorder(tmp_path / name):
            pass
    (tmp_path / "day-3.mcap").write_text("no recording")
    for name in names:
        assert read(tmp_path / name).parts == (tmp_path / name,)
    assert len(siblings(tmp_path / "day-2.mcap")) == 5


def test_part_of_another_recording_is_not_included(parts: tuple[Path, ...], tmp_path: Path) -> None:
    folder = tmp_path / "other"
    with recorder(folder / "run.mcap"):
        pass
    parts[1].rename(folder / "run-2.mcap")
    assert read(folder / "run.mcap").parts == (folder / "run.mcap",)
    assert read(folder / "run-2.mcap").parts == (folder / "run-2.mcap",)


def test_recorded_count_never_decreases_at_next_part(tmp_path: Path) -> None:
    counted, sizes = [0], [0]
    with recorder(tmp_path / "run.mcap", rotation=ROTATION) as recording:
        for sample in Fleet().positions(10.0, 16.0):
            recording.write(sample, sample.arrived + EPOCH)
            recording.flush(sample.arrived)
            until(lambda: recording._disk.safe.number == recording._handed)
            counted.append(recording.recorded.total())
            sizes.append(recording.bytes)
        assert len(recording.paths) > 2
    assert counted == sorted(counted)
    assert counted[-1] > 0.8 * len(Fleet().positions(10.0, 16.0))
    assert sizes == sorted(sizes)


def test_new_part_does_not_overwrite_existing_file(tmp_path: Path) -> None:
    (tmp_path / "run-2.mcap").write_text("dear")
    with recorder(tmp_path / "run.mcap", rotation=ROTATION) as recording:
        for sample in Fleet().positions(10.0, 14.0):
            recording.write(sample, sample.arrived)
            recording.flush(sample.arrived)
    assert (tmp_path / "run-2.mcap").read_text() == "dear"
    assert [path.name for path in recording.paths][:2] == ["run.mcap", "run-3.mcap"]
    assert len(read(tmp_path / "run.mcap").parts) == len(recording.paths)


def test_parts_stay_within_rotation_size(tmp_path: Path) -> None:
    with recorder(tmp_path / "run.mcap", rotation=Rotation(size=60_000)) as recording:
        for sample in Fleet().positions(10.0, 40.0):
            recording.write(sample, sample.arrived)
            recording.flush(sample.arrived)
    sizes = [path.stat().st_size for path in recording.paths]
    assert len(sizes) > 2
    assert max(sizes) <= 60_000
    assert len(list(read(tmp_path / "run.mcap").messages())) == len(Fleet().positions(10.0, 40.0))


@pytest.mark.parametrize(
    ("text", "size"),
    [("100MB", 1e8), ("1 GB", 1e9), ("1.5gb", 1.5e9), ("1GiB", 2**30), ("500kB", 5e5), ("off", None)],
)
def test_size_units_are_parsed(text: str, size: float | None) -> None:
    assert of_size(text) == size


@pytest.mark.parametrize(("text", "time"), [("90s", 90.0), ("30min", 1800.0), ("2h", 7200.0), ("off", None)])
def test_time_units_are_parsed(text: str, time: float | None) -> None:
    assert of_time(text) == time


@pytest.mark.parametrize("text", ["1", "GB", "-1GB", "1TBs", "", "0", "1 kB", "nan GB", "٣GB"])
def test_invalid_size_error_names_valid_forms(text: str) -> None:
    with pytest.raises(argparse.ArgumentTypeError, match=r"(kB, MB, GB, KiB, MiB, GiB\).*|100kB), or off"):
        of_size(text)


def test_reading_invalid_file_raises_unreadable_error(tmp_path: Path) -> None:
    (tmp_path / "run.mcap").write_text("no")
    with pytest.raises(UnreadableError):
        read(tmp_path / "run.mcap")
