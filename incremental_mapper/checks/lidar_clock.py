"""One LiDAR of several whose clock is off: it turns before or after the IMU, unlike the others."""

from collections.abc import Mapping

from incremental_mapper.checks.finding import Finding, Severity
from incremental_mapper.checks.imu_beside_lidar import CERTAIN, CLOCK_GAIN, LAG
from incremental_mapper.checks.imu_motion import MAX_LAG, Comparison, MotionEvidence


def lidar_clock_findings(
    lidars: Mapping[str, MotionEvidence], offsets: Mapping[str, float]
) -> list[Finding]:
    """Hold the clock of each LiDAR against that of the IMU.

    Args:
        lidars: Its matches, and the samples of the one IMU.
        offsets: Seconds that are added to the stamps of each already.

    Returns:
        ``lidar_clock``, mended, for each that is off while another one is in time; nothing where
        they turn too little, or all are off: then it is the IMU's clock.
    """
    in_time: list[float] = []
    late: dict[str, tuple[float, float]] = {}
    for name, evidence in lidars.items():
        comparison = Comparison(evidence)
        best = comparison.best()
        if best is None or best.likelihood < CERTAIN:
            return []
        if abs(best.lag) <= LAG + comparison.half:
            in_time.append(best.lag)
        elif abs(best.lag) < MAX_LAG - LAG and comparison.support(best.lag) >= CLOCK_GAIN:
            late[name] = best.lag, best.turned
        else:
            return []
    if not in_time:
        return []
    # Where clouds have no point times the lag is half a sweep for all of them.
    usual = sum(in_time) / len(in_time)
    return [_finding(name, lag - usual, turned, offsets) for name, (lag, turned) in late.items()]


def _finding(name: str, lag: float, turned: float, offsets: Mapping[str, float]) -> Finding:
    offset = round(offsets.get(name, 0.0) - lag, 3)
    return Finding(
        'lidar_clock',
        Severity.MENDED,
        name,
        f'its clock is {abs(lag):.3f} s {"ahead of" if lag > 0.0 else "behind"} those of the IMU '
        f'and the other LiDARs (correlation {turned:.2f} of the rotations with it)',
        f'shifted; lidars.{name}.time_offset: {offset:g}',
        {'lidars': {name: {'time_offset': offset}}},
    )
