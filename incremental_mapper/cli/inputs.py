"""The argument that commands on one recording have in common."""

import argparse
from pathlib import Path


def add_input(parser: argparse.ArgumentParser) -> None:
    """Add INPUT, a recording of any kind that can be read."""
    parser.add_argument(
        'input',
        type=Path,
        metavar='INPUT',
        help='KAIST folder, rosbag2 (MCAP or sqlite3), ROS 1 bag, or folder of .bin scans',
    )
