"""``incremental_mapper play``: a bag's messages on ROS topics, at their own pace."""

import argparse
import math
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from tqdm import tqdm

from incremental_mapper.cli import exit_status
from incremental_mapper.cli.keyboard import Keyboard
from incremental_mapper.errors import InputError

BAR_FORMAT = '{desc}: {percentage:3.0f}%|{bar}| {n:.1f}/{total:.1f} s [{elapsed}<{remaining}]'


def add_parser(subparsers: Any) -> None:
    """Add the command to the ``argparse`` sub-parsers of the program."""
    parser = subparsers.add_parser(
        'play',
        description='Publish the messages of a rosbag2 (MCAP or sqlite3) or ROS 1 bag on the '
        'topics that they were recorded from, as long after each other as they were logged. '
        'Space pauses and goes on. Topics whose message type is not installed are left out.',
    )
    parser.add_argument('bag', type=Path, metavar='BAG', help='bag folder or file')
    parser.add_argument(
        '--rate',
        type=_positive,
        default=1.0,
        metavar='R',
        help='times the speed of the recording (default: 1)',
    )
    parser.add_argument('--loop', action='store_true', help='begin again at the end, until Ctrl-C')
    parser.add_argument(
        '--start',
        type=_not_negative,
        default=0.0,
        metavar='S',
        help='leave out the first S seconds of the bag',
    )
    parser.add_argument(
        '--duration',
        type=_positive,
        metavar='D',
        help='play D seconds of the bag (default: to its end)',
    )
    parser.add_argument(
        '--topics', nargs='+', default=[], metavar='TOPIC', help='play these only (default: all)'
    )
    parser.add_argument(
        '--clock',
        action='store_true',
        help="publish the bag's time on /clock, for nodes with use_sim_time",
    )
    waiting = parser.add_mutually_exclusive_group()
    waiting.add_argument(
        '--wait',
        type=_not_negative,
        default=60.0,
        metavar='S',
        help='seconds to wait at most for subscriptions before the first message (default: '
        '%(default)g); begins sooner when there are some and no more come, or with Space. A '
        'mapper that has just been started is waited for',
    )
    waiting.add_argument(
        '--no-wait',
        dest='wait',
        action='store_const',
        const=0.0,
        help='begin at once, whoever listens',
    )
    parser.set_defaults(func=run)


def run(args: argparse.Namespace) -> int:
    """Run the command; raises MapperError where the bag cannot be played."""
    try:
        from incremental_mapper.ros.player.playback import PlayOptions, open_player
    except ImportError as error:
        if (error.name or '').split('.')[0] == 'incremental_mapper':
            raise
        raise InputError(
            f'play needs rclpy, which cannot be imported ({error}); '
            'pip install "incremental_mapper[ros]", or source a ROS 2 installation'
        ) from error
    options = PlayOptions(
        rate=args.rate,
        loop=args.loop,
        start=args.start,
        duration=args.duration,
        topics=tuple(args.topics),
        clock=args.clock,
        wait=args.wait,
    )
    with (
        _termination_unwinds(),
        Keyboard() as keyboard,
        open_player(args.bag, options, terminal := _Terminal(keyboard)) as player,
    ):
        for note in player.notes:
            print(f'note: {note}', file=sys.stderr)
        if not player.wait_for_subscriptions(lambda text: print(text, file=sys.stderr)):
            print('note: nothing has subscribed yet', file=sys.stderr)
        try:
            player.play()
        finally:
            terminal.close()
            print(f'{args.bag}: {player.report}', flush=True)
        if not player.wait_for_acknowledgement():
            print('note: a subscriber did not acknowledge the last messages', file=sys.stderr)
        left_out = player.report.missing + player.report.unreadable
    return exit_status.FAILURE if left_out else 0


class _Terminal:
    """Keyboard and progress bar for the player."""

    def __init__(self, keyboard: Keyboard) -> None:
        self.wait = keyboard.wait
        self._bar: Any = None

    def show(self, done: float, total: float, paused: bool) -> None:
        """Draw the bar; times are seconds of the bag."""
        if self._bar is None:
            # disable=None shows the bar on a terminal only, miniters=0 also while nothing moves.
            self._bar = tqdm(
                desc='play', total=total, disable=None, miniters=0, bar_format=BAR_FORMAT
            )
        if done < self._bar.n:  # another round
            self._bar.reset(total)
        self._bar.set_description_str('paused' if paused else 'play', refresh=False)
        self._bar.update(max(done, 0.0) - self._bar.n)

    def close(self) -> None:
        """Leave the bar as it is."""
        if self._bar is not None:
            self._bar.close()


@contextmanager
def _termination_unwinds() -> Iterator[None]:
    """Let SIGTERM leave the terminal and the ROS graph in order, as Ctrl-C does."""
    before = signal.signal(signal.SIGTERM, lambda number, _: sys.exit(128 + number))
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


def _positive(text: str) -> float:
    number = _not_negative(text)
    if number == 0:
        raise argparse.ArgumentTypeError(f'{text!r} is not greater than 0')
    return number


def _not_negative(text: str) -> float:
    try:
        number = float(text)
    except ValueError:
        number = math.nan
    if not (math.isfinite(number) and number >= 0):
        raise argparse.ArgumentTypeError(f'{text!r} is no number of 0 or more')
    return number
