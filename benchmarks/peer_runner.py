"""Runs one peer over prepared measurements; it lives in the peers' environment, see ``peers.py``.

    python peer_runner.py (kiss-icp|kiss-slam|rko_lio) FOLDER OUT.npz

FOLDER holds ``events.npz`` and a file for each scan. Written are stamps (ns), poses (N, 4, 4), the
seconds that the peer itself took, and its version. Nothing of the package is imported.
"""

import sys
import time
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np


def kiss_icp(events: Any, folder: Path) -> tuple[list[int], list[Any], float]:
    """KISS-ICP with its defaults; poses of base_link."""
    from kiss_icp.config import load_config
    from kiss_icp.kiss_icp import KissICP

    odometry, spent = KissICP(load_config(None)), 0.0
    lidar = events['T_base_lidar']
    stamps, poses = [], []
    for kind, stamp in zip(events['kinds'], events['stamps'], strict=True):
        if kind < 0:
            continue
        scan = np.load(folder / f'{kind}.npy').astype(np.float64)
        times = scan[:, 3] - scan[:, 3].min()
        shares = times / times.max() if times.max() > 0.0 else np.array([])
        began = time.perf_counter()
        odometry.register_frame(np.ascontiguousarray(scan[:, :3]), shares)
        spent += time.perf_counter() - began
        stamps.append(int(stamp) + round(float(scan[:, 3].max()) * 1e9))
        poses.append(lidar @ odometry.last_pose @ np.linalg.inv(lidar))
    return stamps, poses, spent


def kiss_slam(events: Any, folder: Path) -> tuple[list[int], list[Any], float]:
    """KISS-SLAM with its defaults, after its last optimisation; poses of base_link."""
    from kiss_slam.config import load_config
    from kiss_slam.slam import KissSLAM

    slam, spent = KissSLAM(load_config(None)), 0.0
    lidar = events['T_base_lidar']
    stamps = []
    for kind, stamp in zip(events['kinds'], events['stamps'], strict=True):
        if kind < 0:
            continue
        scan = np.load(folder / f'{kind}.npy').astype(np.float64)
        times = scan[:, 3] - scan[:, 3].min()
        shares = times / times.max() if times.max() > 0.0 else np.array([])
        began = time.perf_counter()
        slam.process_scan(np.ascontiguousarray(scan[:, :3]), shares)
        spent += time.perf_counter() - began
        stamps.append(int(stamp) + round(float(scan[:, 3].max()) * 1e9))
    began = time.perf_counter()
    slam.generate_new_node()
    slam.local_map_graph.erase_last_local_map()
    found, _ = slam.fine_grained_optimization()
    spent += time.perf_counter() - began
    poses = [lidar @ np.asarray(pose) @ np.linalg.inv(lidar) for pose in found]
    print(
        f'kiss-slam: {len(slam.get_closures())} closures, {len(stamps)} scans, {len(poses)} poses'
    )
    count = min(len(poses), len(stamps))
    return stamps[:count], poses[:count], spent


def rko_lio(events: Any, folder: Path) -> tuple[list[int], list[Any], float]:
    """rko_lio with its defaults; poses of base_link."""
    from rko_lio.config import LIOConfig
    from rko_lio.lio import LIO

    odometry, spent = LIO(LIOConfig()), 0.0
    stamps, poses = [], []
    waiting: list[tuple[Any, Any]] = []
    newest = -1
    for kind, stamp, values in zip(events['kinds'], events['stamps'], events['imu'], strict=True):
        if kind >= 0:
            scan = np.load(folder / f'{kind}.npy').astype(np.float64)
            times = int(stamp) + np.rint(scan[:, 3] * 1e9).astype(np.int64)
            waiting.append((np.ascontiguousarray(scan[:, :3]), times))
        else:
            newest = int(stamp)
        began = time.perf_counter()
        if kind < 0:
            odometry.add_imu_measurement(values[3:], values[:3], int(stamp), events['T_base_imu'])
        # It wants the samples of a whole sweep before the sweep.
        while waiting and waiting[0][1].max() <= newest:
            points, times = waiting.pop(0)
            odometry.register_scan(points, times, events['T_base_lidar'])
            stamps.append(int(times.max()))
            poses.append(odometry.pose())
        spent += time.perf_counter() - began
    return stamps, poses, spent


def main() -> None:
    """Run the peer that is named."""
    name, folder, out = sys.argv[1], Path(sys.argv[2]), sys.argv[3]
    events = np.load(folder / 'events.npz')
    run = {'kiss-icp': kiss_icp, 'kiss-slam': kiss_slam, 'rko_lio': rko_lio}[name]
    stamps, poses, spent = run(events, folder)
    np.savez(out, stamps=stamps, poses=poses, seconds=spent, version=version(name))


if __name__ == '__main__':
    main()
