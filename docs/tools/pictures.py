"""Draws the pictures of the pages from real runs, in both themes.

    python docs/tools/pictures.py RUNS DRIVE OUT_DIR

RUNS is an evaluation of one drive (RUNS/base, RUNS/mom), DRIVE the simulated folder with its truth;
"make pictures" makes both.
"""

import argparse
import subprocess
import sys
from pathlib import Path

from PIL import Image

COLOURS = 256
"""Enough for what is drawn; the files become a quarter as large."""


def draw(runs: Path, truth: Path, out_dir: Path) -> None:
    """Draw every picture of the pages with ``incremental_mapper plot``."""
    out_dir.mkdir(parents=True, exist_ok=True)
    mom, base = str(runs / 'mom'), str(runs / 'base')
    pictures = {
        'graph': ['graph', mom, '--from', '18.0', '--to', '19.1'],
        'graph_base': ['graph', base, '--from', '18.0', '--to', '19.1'],
        'map': ['map', mom],
        'map_side': ['map', mom, '--side'],
        'trajectory': ['trajectory', mom, '--truth', str(truth)],
    }
    for name, words in pictures.items():
        for theme in ('light', 'dark'):
            file = out_dir / f'{name}_{theme}.png'
            command = [sys.executable, '-m', 'incremental_mapper.cli.main', 'plot', *words]
            subprocess.run([*command, '--theme', theme, '--out', str(file)], check=True)
            with Image.open(file) as image:
                small = image.convert('RGB').quantize(COLOURS, Image.Quantize.MAXCOVERAGE, kmeans=4)
            small.save(file, optimize=True)


def main() -> None:
    """Read the command line and draw."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('runs', type=Path, metavar='RUNS')
    parser.add_argument('drive', type=Path, metavar='DRIVE')
    parser.add_argument('out_dir', type=Path, metavar='OUT_DIR')
    args = parser.parse_args()
    draw(args.runs, args.drive / 'global_pose.csv', args.out_dir)


if __name__ == '__main__':
    main()
