"""``incremental_mapper convert``: a KAIST folder to a ROS 2 bag."""

import argparse
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import yaml
from tqdm import tqdm

from incremental_mapper.datasets.bag_settings import SETTINGS_FILE
from incremental_mapper.datasets.bag_writer import TOPICS, BagWriter, bag_settings, with_truth
from incremental_mapper.datasets.kaist_files import Recording, read_recording
from incremental_mapper.datasets.topics import TRUTH_TOPIC
from incremental_mapper.datasets.truth import find_truth
from incremental_mapper.errors import MeasurementError, OutputError
from incremental_mapper.measurements import NANOSECONDS, Drops
from incremental_mapper.settings import write_ros_yaml

METADATA = 'metadata.yaml'


@dataclass(frozen=True, slots=True)
class ConvertSummary:
    """What was written: messages by topic, records left out, seconds of the recording."""

    path: Path
    messages: dict[str, int]
    drops: Drops
    duration: float
    notes: tuple[str, ...]

    def __str__(self) -> str:
        lines = [f'{self.path}: {sum(self.messages.values())} messages, {self.duration:.1f} s']
        lines += [f'  {topic}: {count}' for topic, count in self.messages.items()]
        lines += [
            f'  left out: {count} of {sensor} ({reason})'
            for (sensor, reason), count in sorted(self.drops.items())
        ]
        lines += [f'  note: {note}' for note in self.notes]
        return '\n'.join(lines)


def add_parser(subparsers: Any) -> None:
    """Add the command to the ``argparse`` sub-parsers of the program."""
    parser = subparsers.add_parser(
        'convert',
        description='Convert a KAIST Complex Urban folder to a ROS 2 bag (MCAP) with PointCloud2, '
        f'Imu, NavSatFix and, where there is global_pose.csv, {TRUTH_TOPIC}. '
        f'Topics and extrinsics go into {SETTINGS_FILE} in the bag, in the layout of a ROS '
        'parameter file.',
    )
    parser.add_argument('kaist_dir', type=Path, metavar='KAIST_DIR', help='folder of one sequence')
    parser.add_argument('out_bag', type=Path, metavar='OUT_BAG', help='bag folder to write')
    parser.add_argument(
        '--force', action='store_true', help='replace a bag that this command wrote before'
    )
    parser.set_defaults(func=run)


def run(args: argparse.Namespace) -> int:
    """Run the command; raises MapperError where input or output cannot be used."""
    print(convert(args.kaist_dir, args.out_bag, args.force, progress=True))
    return 0


def convert(
    kaist_dir: Path, out_bag: Path, force: bool = False, progress: bool = False
) -> ConvertSummary:
    """Write the bag of a KAIST folder; memory does not grow with the clouds.

    The bag appears in place when it is complete; an interrupted run leaves no half bag.
    Raises InputError for the folder, OutputError where ``out_bag`` exists and ``force`` is not
    given, where it is another program's bag, or where it cannot be written.
    """
    out = out_bag.resolve()
    _check_output(kaist_dir.resolve(), out, force)
    recording = read_recording(kaist_dir)
    truth = find_truth([kaist_dir, kaist_dir / 'sensor_data'])
    everything = recording if truth is None else with_truth(recording, truth)
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        with TemporaryDirectory(prefix=f'.{out.name}.', dir=out.parent) as scratch:
            made = Path(scratch) / out.name
            written, drops = _write(made, everything, progress)
            write_ros_yaml(
                made / SETTINGS_FILE,
                bag_settings(recording),
                f'Topics and extrinsics of {kaist_dir.resolve().name}, converted from KAIST files.',
            )
            out.mkdir(exist_ok=True)
            # The metadata come last: they are what makes the folder a bag.
            for name in (_storage_name(out), SETTINGS_FILE, METADATA):
                (made / name).replace(out / name)
    except OSError as error:
        raise OutputError(f'{out_bag}: cannot be written ({error.strerror or error})') from error
    first, last = recording.span()
    return ConvertSummary(
        path=out_bag,
        messages={TOPICS[sensor]: written[TOPICS[sensor]] for sensor in everything.streams},
        drops=drops,
        duration=(last - first) / NANOSECONDS,
        notes=recording.notes,
    )


def _check_output(kaist_dir: Path, out_bag: Path, force: bool) -> None:
    if not out_bag.exists():
        return
    if not out_bag.is_dir():
        raise OutputError(f'{out_bag}: is a file; give the name of a bag folder')
    if out_bag == kaist_dir:
        raise OutputError(f'{out_bag}: is the KAIST folder itself; give another name')
    if not force:
        raise OutputError(f'{out_bag}: exists; use --force to replace it, or another name')
    metadata = out_bag / METADATA
    if metadata.is_file() and _bag_parts(metadata) != [_storage_name(out_bag)]:
        raise OutputError(
            f'{out_bag}: is a bag that this command did not write; --force does not replace it'
        )


def _bag_parts(metadata: Path) -> list[str]:
    """File names of the bag that a metadata.yaml describes; empty where it describes none."""
    try:
        tree = yaml.safe_load(metadata.read_text(encoding='utf-8'))
        return [str(name) for name in tree['rosbag2_bagfile_information']['relative_file_paths']]
    except (OSError, UnicodeDecodeError, yaml.YAMLError, KeyError, TypeError):
        return []


def _storage_name(out_bag: Path) -> str:
    return f'{out_bag.name}.mcap'


def _write(folder: Path, recording: Recording, progress: bool) -> tuple[Counter[str], Drops]:
    """Write the bag itself; returns messages by topic and what was left out."""
    written: Counter[str] = Counter()
    drops = recording.drops.copy()
    records = tqdm(
        recording.order({}),
        total=sum(len(stream.stamps) for stream in recording.streams.values()),
        desc='convert',
        unit='msg',
        # None shows the bar on a terminal only.
        disable=None if progress else True,
    )
    with BagWriter(folder, list(recording.streams)) as writer:
        for stamp, sensor, index in records:
            try:
                record = recording.streams[sensor].load(index)
            except MeasurementError as error:
                drops[sensor, error.reason] += 1
                continue
            writer.write(sensor, stamp, record)
            written[TOPICS[sensor]] += 1
    return written, drops
