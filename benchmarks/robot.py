"""The node where it broke on a real robot: what was seen before, and what is seen now.

    python benchmarks/robot.py [ROW...] [--long] [--list]

Runs the rows of ``robot_rows``: those that are named (``inputs.clouds``, or ``inputs`` for all of
a subject), else all but those that take minutes; ``--long`` runs these too. Prints Markdown. Exit
status 1 where a row fails.
"""

import argparse
import sys
import traceback
from collections.abc import Iterable, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

from robot_rows import Row, Seen, all_rows


def main() -> int:
    """Returns the exit status."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('rows', nargs='*', metavar='ROW', help='name or subject; default: all')
    parser.add_argument('--long', action='store_true', help='also those that take minutes')
    parser.add_argument('--list', action='store_true', help='list the rows and end')
    args = parser.parse_args()
    rows = all_rows()
    if args.list:
        for name, item in rows.items():
            print(f'{name}: {item.tried}' + ' (long)' * item.long)
        return 0
    unknown = [word for word in args.rows if not any(named(name, word) for name in rows)]
    if unknown:
        parser.error(f'no row is called {", ".join(unknown)}; there are {", ".join(rows)}')
    wanted = chosen(rows.values(), args.rows, args.long)
    if not wanted:
        parser.error('no row is left; those that take minutes need --long')
    print('| row | tried | before | now | verdict |')
    print('|---|---|---|---|---|')
    verdicts = [shown(item) for item in wanted]
    print(f'\n{sum(verdicts)} of {len(verdicts)} rows are as they should be')
    return 0 if all(verdicts) else 1


def named(name: str, word: str) -> bool:
    """Whether a row of that name is meant by a word of the user."""
    return name == word or name.startswith(f'{word}.')


def chosen(rows: Iterable[Row], words: Sequence[str], long: bool) -> list[Row]:
    """The rows that are to be run: a row that is named in full is run however long it takes."""
    return [
        item
        for item in rows
        if (not words or any(named(item.name, word) for word in words))
        and (long or not item.long or item.name in words)
    ]


def shown(item: Row) -> bool:
    """Run a row and print its line; returns whether it is as it should be."""
    # What a node started may still write into it.
    with TemporaryDirectory(prefix='robot_', ignore_cleanup_errors=True) as folder:
        try:
            seen = item.run(Path(folder))
        # A row that breaks is a row that fails; the others are still run.
        except Exception as error:
            traceback.print_exc()
            seen = Seen(f'{type(error).__name__}: {error}', False)
    verdict = 'ok' if seen.ok else 'FAILS'
    cells = (item.name, item.tried, item.before, ' '.join(seen.now.split()), verdict)
    print('| ' + ' | '.join(cell.replace('|', '/') for cell in cells) + ' |', flush=True)
    return seen.ok


if __name__ == '__main__':
    sys.exit(main())
