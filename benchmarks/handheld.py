"""Mapping a LiDAR that is carried by hand, without fixes, with the IMU's help and without.

    python benchmarks/handheld.py [--seconds 60] [--seeds 1 2] [--set KEY=VALUE]

The motion is simulated: turns of 2 rad/s with peaks of 4 rad/s, steps, jolts; a LiDAR of 24 beams
at 10 Hz with point times, an IMU at 200 Hz. Printed is the error of the trajectory after the best
rigid fit (ATE) with ``odometry.imu_guess`` on and off; --set names further changes of both runs.
"""

import argparse
import time
from contextlib import closing

from odometry import changed

from incremental_mapper.datasets.simulated.handheld import SETTINGS, Walk
from incremental_mapper.mapping.mapper import Mapper
from incremental_mapper.results.trajectory_errors import trajectory_errors
from incremental_mapper.settings import make_config


def main() -> None:
    """Map every walk with and without the IMU's help."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('--seconds', type=float, default=60.0)
    parser.add_argument('--seeds', type=int, nargs='+', default=[1, 2])
    parser.add_argument('--set', action='append', default=[], metavar='KEY=VALUE,...')
    args = parser.parse_args()
    for text in args.set or ['']:
        print(
            f'\n{text or "settings as they are"}\nseed  imu_guess   ATE m  RPE/s m  seconds  notes'
        )
        for seed in args.seeds:
            for guess in ('true', 'false'):
                walk = Walk(seed)
                tree = changed(changed(SETTINGS, text), f'odometry.imu_guess={guess}')
                began = time.perf_counter()
                with closing(Mapper(make_config(tree), ['lidar', 'imu'])) as mapper:
                    for measurement in walk.measurements(args.seconds):
                        mapper.push(measurement)
                    result = mapper.finish()
                spent = time.perf_counter() - began
                errors = trajectory_errors(result.trajectory, walk.truth(args.seconds))
                if errors is None:
                    raise SystemExit('no pose')
                per_second = errors.rpe_per_second_translation_rmse_m or float('nan')
                notes = ', '.join(f'{key} {value}' for key, value in result.stats['notes'].items())
                print(
                    f'{seed:4}  {guess:9} {errors.ate_rmse_m:7.4f}  {per_second:7.4f}  '
                    f'{spent:7.1f}  {notes}',
                    flush=True,
                )


if __name__ == '__main__':
    main()
