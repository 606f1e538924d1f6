"""Ours and the pipelines of evalio on the same drives, without fixes, in one table.

    python benchmarks/evalio_table.py INPUT[=CONFIG.yaml] ... [--pipelines kiss,...]
        [--set KEY=VALUE,...] [--cache FOLDER] [--keep OUT]

INPUT is a KAIST folder or a bag, CONFIG tells where its sensors are. evalio and this package are
installed into an environment of their own below --cache, at the first run only. Everybody gets one
LiDAR (the first) and the IMU, and runs with its defaults; --set names further runs of ours with
other settings. Every run is a process of its own. ATE is after the best rigid fit, drift the mean
error of motions over 10 to 400 m in m per 100 m, seconds those inside the pipeline, and memory by
how much its process has more at its peak than one that only reads the input.
"""

import argparse
import os
import re
import subprocess
import tempfile
import time
import venv
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from peers import CACHE, drift

from incremental_mapper.datasets.open import open_source
from incremental_mapper.results.trajectory_errors import trajectory_errors
from incremental_mapper.settings import read_yaml
from incremental_mapper.trajectory import Trajectory

EVALIO = 'evalio==0.6.1'
ROOT = Path(__file__).parents[1]
MODULE = 'incremental_mapper.evaluation.evalio_module'
OURS = 'incremental_mapper'
PIPELINES = (OURS, 'kiss', 'genz', 'ct', 'mad', 'loam', 'liosam', 'dlio', 'form')
READER, READING = 'evalio_reader', 'reading'
"""Module and pipeline that do nothing with what they are given."""
PATIENCE = 600
"""Seconds that one run may take."""
LOOK = 0.05
"""Seconds between two looks at the memory of a run."""


def environment(cache: Path) -> Path:
    """The folder of evalio's programs, made where it is not there yet."""
    folder = cache / 'evalio'
    done = folder / 'installed.txt'
    wanted = f'{EVALIO}\n{ROOT}'
    if not done.exists() or done.read_text(encoding='utf-8') != wanted:
        venv.create(folder, with_pip=True, clear=True)
        words = [folder / 'bin' / 'python', '-m', 'pip', 'install', '-qq', EVALIO, '-e', str(ROOT)]
        subprocess.run(words, check=True)
        # Nobody is to be charged for the compiler.
        compiled = 'from incremental_mapper import Config, Mapper; Mapper(Config()).close()'
        subprocess.run([folder / 'bin' / 'python', '-c', compiled], check=True)
        done.write_text(wanted, encoding='utf-8')
    return folder / 'bin'


def run(
    programs: Path, name: str, place: str, pipeline: dict[str, Any], out: Path
) -> tuple[str, float]:
    """Run a pipeline on an input; what it printed last, and the peak of its memory in MB."""
    config = out / 'table.yaml'
    tree = {'datasets': [f'mapper_inputs/{name}'], 'pipelines': [pipeline]}
    config.write_text(yaml.safe_dump(tree), encoding='utf-8')
    surroundings = os.environ | {
        'EVALIO_CUSTOM': f'{MODULE},{READER}',
        'PYTHONPATH': str(Path(__file__).parent.absolute()),
        'EVALIO_MAPPER_INPUTS': f'{name}={place}',
        'EVALIO_DATA': str(out),
    }
    peak = 0.0
    with tempfile.TemporaryFile('w+') as said:
        words = ['timeout', str(PATIENCE), str(programs / 'evalio'), 'run', '-c', str(config)]
        process = subprocess.Popen(words, stdout=said, stderr=said, env=surroundings, cwd=out)
        while process.poll() is None:
            peak = max(peak, inner_peak(process.pid))
            time.sleep(LOOK)
        said.seek(0)
        lines = [line.strip() for line in said.read().splitlines() if line.strip()]
    return (lines or [f'status {process.returncode}'])[-1], peak


def inner_peak(process: int) -> float:
    """Peak so far of the memory, MB, of the process that evalio forks for a pipeline.

    evalio itself has read the input by then, and has the larger peak whatever it runs. It stands
    below ``timeout``, which is the one given.
    """
    try:
        for _ in range(2):
            children = Path(f'/proc/{process}/task/{process}/children').read_text(encoding='utf-8')
            process = int(children.split()[-1])
        status = Path(f'/proc/{process}/status').read_text(encoding='utf-8')
    except (OSError, IndexError):
        return 0.0  # not there yet, or not any more
    found = re.search(r'VmHWM:\s*(\d+) kB', status)
    return 0.0 if found is None else int(found[1]) / 1024


def read(file: Path) -> tuple[dict[str, str], Trajectory | None]:
    """What evalio says of a run, and the trajectory; None where there are hardly any poses."""
    if not file.is_file():
        return {}, None
    text = file.read_text(encoding='utf-8')
    said = dict(re.findall(r'^# (\w+): (.*)$', text, flags=re.MULTILINE))
    rows = [line.split(',') for line in text.splitlines() if line and line[0].isdigit()]
    if len(rows) < 2:
        return said, None
    stamps = []
    for row in rows:
        seconds, _, rest = row[0].strip().partition('.')
        stamps.append(int(seconds) * 10**9 + int(rest.ljust(9, '0')[:9]))
    numbers = np.array([[float(value) for value in row[1:8]] for row in rows])
    if not np.isfinite(numbers).all() or not np.linalg.norm(numbers[:, 3:7], axis=1).all():
        return said | {'status': 'numbers that are no poses'}, None
    order = np.unique(stamps, return_index=True)[1]
    made = Trajectory(np.array(stamps)[order], numbers[order, :3], numbers[order, 3:7])
    return said, made


def main() -> None:
    """Run every pipeline over every input."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('inputs', nargs='+', metavar='INPUT[=CONFIG.yaml]')
    parser.add_argument('--pipelines', default=','.join(PIPELINES), metavar='NAME,...')
    parser.add_argument('--set', action='append', default=[], metavar='KEY=VALUE,...')
    parser.add_argument('--cache', type=Path, default=CACHE)
    parser.add_argument('--keep', type=Path, metavar='OUT', help="evalio's files")
    args = parser.parse_args()
    programs = environment(args.cache.absolute())
    print(EVALIO)
    pipelines: list[dict[str, Any]] = []
    for number, change in enumerate(args.set):
        pairs = [word.split('=', 1) for word in change.split(',')]
        chosen = {key: yaml.safe_load(value) for key, value in pairs}
        pipelines.append({'name': f'{OURS}_{number + 1}', 'pipeline': OURS, **chosen})
        print(f'{OURS}_{number + 1}: {change}')
    others = args.pipelines.split(',')
    pipelines = [{'name': name, 'pipeline': name} for name in others[:1]] + pipelines
    pipelines += [{'name': name, 'pipeline': name} for name in others[1:]]
    with tempfile.TemporaryDirectory() as folder:
        out = (args.keep or Path(folder)).absolute()
        out.mkdir(parents=True, exist_ok=True)
        for place in args.inputs:
            where = [Path(part).absolute() for part in place.split('=')]
            path, config = where[0], where[1] if len(where) > 1 else None
            name = re.sub(r'\W', '_', path.name)
            truth = open_source(path, {} if config is None else read_yaml(config)).truth()
            print(f'{place}\n  {"":28} {"ATE m":>9} {"m/100 m":>9} {"seconds":>9} {"MB":>6}')
            reading = {'name': READING, 'pipeline': READING}
            _, before = run(programs, name, '='.join(map(str, where)), reading, out)
            for pipeline in pipelines:
                last, memory = run(programs, name, '='.join(map(str, where)), pipeline, out)
                file = f'{pipeline["name"]}.csv'
                said, made = read(out / 'evalio_results/table/mapper_inputs' / name / file)
                label = f'{pipeline["name"]} {said.get("pipeline_version", "")}'
                if made is None or said.get('status') != 'complete':
                    print(f'  {label:28} no answer ({said.get("status") or last})', flush=True)
                    continue
                errors = None if truth is None else trajectory_errors(made, truth)
                ate = np.nan if errors is None else errors.ate_rmse_m
                moved = np.nan if truth is None else drift(made, truth)
                seconds = float(said['total_elapsed'])
                more = memory - before
                print(
                    f'  {label:28} {ate:9.4f} {moved:9.3f} {seconds:9.2f} {more:6.0f}', flush=True
                )


if __name__ == '__main__':
    main()
