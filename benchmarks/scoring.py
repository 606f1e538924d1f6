"""What scoring costs, and whether it agrees with searching every neighbourhood again.

    python benchmarks/scoring.py DRIVE [--config config/kaist.yaml] [--windows 200]
        [--candidates 30] [--every 5]

Maps a drive, a KAIST folder or a bag, and times the scoring of its windows once more: thread CPU
time in ms. A window has few candidates, so the cost of one among many is measured at
--candidates of them: the window's own and others, whose scans are moved by normal noise of 1 cm
and 0.5 mrad. OMP_NUM_THREADS=1 and OPENBLAS_NUM_THREADS=1 keep the figures comparable.
"""

import argparse
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from incremental_mapper.config import Config, MomSettings
from incremental_mapper.datasets.open import open_source
from incremental_mapper.datasets.source import Source
from incremental_mapper.mapping.mapper import Mapper
from incremental_mapper.results.opened_drive import effective_config
from incremental_mapper.scoring.mom import LocalMap, choose_query_points, direct_score, fast_scores
from incremental_mapper.selection import window_problem
from incremental_mapper.selection.local_map import LocalMapBuilder
from incremental_mapper.settings import read_yaml

METRES, RADIANS = 0.01, 5e-4
REGRET = 0.005
"""A winner whose direct score is within this share of the best one is as good."""


@dataclass(frozen=True, slots=True)
class Timing:
    """One window in seconds of CPU time; ``error`` is the largest relative one of a fast score."""

    setup: float
    window: float
    each: float
    direct: float
    candidates: int
    same: bool
    regret: float
    error: float


def timed(function: Callable[[], Any]) -> tuple[Any, float]:
    """A result and the thread's CPU seconds that it took."""
    started = time.thread_time()
    result = function()
    return result, time.thread_time() - started


class Recorder(LocalMapBuilder):
    """Keeps every local map that a mapper judges by."""

    local_maps: list[LocalMap] = []  # noqa: RUF012 (shared by all windows)

    def local_map(self, poses: Any) -> LocalMap:
        """See LocalMapBuilder."""
        made = super().local_map(poses)
        self.local_maps.append(made)
        return made


def windows(source: Source, config: Config, count: int) -> Iterator[LocalMap]:
    """The local maps of a drive's first windows."""
    window_problem.LocalMapBuilder = Recorder  # type: ignore[misc]
    mapper = Mapper(config, [name for name, some in source.info.counts.items() if some])
    given = 0
    for measurement in source.measurements():
        mapper.push(measurement)
        for local_map in Recorder.local_maps:
            yield local_map
            given += 1
            if given == count:
                return
        Recorder.local_maps.clear()


def jittered(local_map: LocalMap, count: int, rng: np.random.Generator) -> LocalMap:
    """The local_map with ``count`` candidates: its own, and its reference moved at random."""
    poses = np.repeat(local_map.poses[:1], count, axis=0)
    own = min(len(local_map.poses), count)
    turns = Rotation.from_rotvec(rng.normal(scale=RADIANS, size=(poses[..., 0, 0].size, 3)))
    poses[..., :3, :3] = turns.as_matrix().reshape(poses[..., :3, :3].shape) @ poses[..., :3, :3]
    poses[..., :3, 3] += rng.normal(scale=METRES, size=poses[..., :3, 3].shape)
    poses[:own] = local_map.poses[:own]
    return replace(local_map, poses=poses)


def measure(
    local_map: LocalMap, settings: MomSettings, count: int, rng: np.random.Generator
) -> Timing | None:
    """Time one window; None where it has no judge."""
    query_points, setup = timed(lambda: choose_query_points(local_map, settings))
    if query_points is None:
        return None
    fast, scoring = timed(lambda: fast_scores(query_points, local_map.poses, local_map, settings))
    found, searching = timed(lambda: direct_scores(query_points, local_map, settings))
    many = jittered(local_map, count, rng)
    others = choose_query_points(many, settings)
    assert others is not None  # the reference is the same
    _, batch = timed(lambda: fast_scores(others, many.poses, many, settings))
    pick, best = int(fast.argmin()), int(found.argmin())
    return Timing(
        setup=setup,
        window=setup + scoring,
        each=batch / count,
        direct=searching / len(found),
        candidates=len(found),
        same=pick == best,
        regret=float(found[pick] / found[best] - 1.0) if found[best] > 0 else 0.0,
        error=float(np.max(np.abs(fast - found) / np.maximum(found, 1e-12))),
    )


def direct_scores(
    query_points: Any, local_map: LocalMap, settings: MomSettings
) -> NDArray[np.float64]:
    """Every candidate of the local map by searching again."""
    return np.array(
        [direct_score(query_points, poses, local_map, settings) for poses in local_map.poses]
    )


def main() -> None:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('drive', type=Path)
    parser.add_argument('--config', type=Path)
    parser.add_argument('--windows', type=int, default=200)
    parser.add_argument('--candidates', type=int, default=30)
    parser.add_argument('--every', type=int, default=5, help='time every so many windows')
    args = parser.parse_args()
    tree = {} if args.config is None else read_yaml(args.config)
    source = open_source(args.drive, tree)
    config = effective_config(source, tree, str(args.config or 'settings'))
    rng = np.random.default_rng(0)
    timings = [
        timing
        for number, local_map in enumerate(windows(source, config, args.windows))
        if number % args.every == 0
        and (timing := measure(local_map, config.mom, args.candidates, rng)) is not None
    ]
    if not timings:
        raise SystemExit('no window of this drive could be judged')

    def median(name: str) -> float:
        return 1e3 * float(np.median([getattr(timing, name) for timing in timings]))

    chosen = [timing for timing in timings if timing.candidates > 1]
    good = sum(timing.same or timing.regret <= REGRET for timing in chosen)
    mean = np.mean([timing.candidates for timing in timings])
    print(f'windows timed           {len(timings)}, of {mean:.1f} candidates on average')
    print(f'set-up a window         {median("setup"):.2f} ms')
    print(f'all scoring of a window {median("window"):.2f} ms')
    print(f'fast, a candidate       {median("each"):.3f} ms, at {args.candidates} candidates')
    print(f'direct, a candidate     {median("direct"):.2f} ms')
    print(f'direct over fast        {median("direct") / median("each"):.0f}')
    print(f'same winner             {sum(t.same for t in chosen)} of {len(chosen)} windows')
    print(f'as good a winner        {good} of {len(chosen)} windows')
    print(f'largest difference      {max(timing.error for timing in timings):.1e} of the score')


if __name__ == '__main__':
    main()
