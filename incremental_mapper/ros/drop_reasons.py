"""Why measurements are left out: what each reason means, and what to do about it."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class DropReason:
    """What a log says of a reason; the remedy may be empty."""

    meaning: str
    remedy: str = ''


UNKNOWN = DropReason('it could not be used', 'see "Dropped measurements" in docs/messages.md')
_CLOCKS = 'see the findings in the status "checks" of /diagnostics'

DROP_REASONS = {
    'truncated': DropReason(
        'fewer bytes than the header promises', 'the driver or the network cuts messages'
    ),
    'bad_layout': DropReason(
        'fields of the cloud reach beyond a point, or rows beyond the data',
        'row_step is width times point_step in a correct driver',
    ),
    'missing_field': DropReason(
        'a cloud without x, y or z', "name the topic of the LiDAR driver's clouds"
    ),
    'wrong_type': DropReason(
        'a field or message of another type than it should be', 'correct the driver'
    ),
    'implausible': DropReason(
        'an acceleration or a rate beyond imu.max_acceleration or imu.max_rate',
        'check imu.acceleration_scale and imu.rate_scale, and the sensor',
    ),
    'contradicted': DropReason(
        'the IMU turns or accelerates as the scans beside it do not: a knock, a loose plug',
        'fasten the IMU and its plug',
    ),
    'frozen': DropReason(
        'the IMU repeats its sample bit for bit', 'the IMU or its driver hangs: restart it'
    ),
    'switched_off': DropReason('imu.enabled is false'),
    'not_finite': DropReason('numbers that are NaN or infinite', 'correct the driver'),
    'no_finite_points': DropReason(
        'no point of the cloud is finite and off the origin', 'is the LiDAR covered or warming up?'
    ),
    'empty_cloud': DropReason('a cloud without points', 'is the LiDAR covered or warming up?'),
    'too_few_points': DropReason(
        'a cloud with points at hardly any places', 'is the LiDAR covered, or its driver broken?'
    ),
    'no_points_in_range': DropReason(
        'no point between odometry.min_range and odometry.max_range',
        'widen them, or see whether something covers the LiDAR',
    ),
    'bad_shape': DropReason('an array of another length than expected', 'correct the driver'),
    'bad_line': DropReason('a line of a file is none', 'correct the file'),
    'bad_name': DropReason('the name of a scan is no stamp', 'name it by its nanoseconds'),
    'missing_file': DropReason('a scan that is listed is not there'),
    'unreadable': DropReason('a scan cannot be read'),
    'no_common_time': DropReason('the sensor shares no time with the LiDARs', _CLOCKS),
    'no_stamp': DropReason('the header stamp is not set', 'set header stamps in the driver'),
    'undecodable': DropReason('the message cannot be decoded'),
    'damaged': DropReason('the message is missing from the recording'),
    'no_gyro': DropReason(
        'the message says that it has no angular velocity', 'name another topic of the IMU'
    ),
    'no_acceleration': DropReason(
        'the message says that it has no acceleration', 'name another topic of the IMU'
    ),
    'no_fix': DropReason('the receiver says that it has no fix', 'none needed in a tunnel'),
    'no_status': DropReason('the receiver does not say whether it has a fix', 'correct its driver'),
    'low_status': DropReason(
        'the status of the fix is below fixes.min_status', 'lower it if such fixes are good enough'
    ),
    'too_uncertain': DropReason(
        'the deviation of the fix is above fixes.max_sigma',
        'raise it if such fixes are good enough',
    ),
    'gnss_jump': DropReason(
        'the fix contradicts odometry and the other fixes',
        'none needed for a few; for most of them check receiver and extrinsics',
    ),
    'frozen_fix': DropReason(
        'the position repeats while the vehicle moves', 'restart the receiver or its driver'
    ),
    'too_dense': DropReason(
        'another fix that is used is within 10 ms', 'see whether two drivers publish the topic'
    ),
    'datum_outlier': DropReason('the first fixes contradict all later ones', 'none needed'),
    'far_from_datum': DropReason(
        'the fix is too far from the datum of the settings', 'correct the datum, or leave it out'
    ),
    'out_of_range': DropReason('latitude and longitude are no place', 'correct the driver'),
    'duplicate_stamp': DropReason(
        'the same sensor and stamp a second time', 'does a bag play twice, or have two publishers?'
    ),
    'repeated_cloud': DropReason(
        'the cloud repeats the points of one before it', 'see the driver, or what republishes it'
    ),
    'other_layout': DropReason(
        'the layout had to be guessed among clouds that are labelled properly',
        'see whether two drivers publish the topic',
    ),
    'late': DropReason(
        'older than a window that is closed, and no place is left',
        'was it sent before (a bag that plays twice, two publishers)? else raise window.lateness',
    ),
    'stamp_leap': DropReason(
        'a stamp far in the future or the past that nothing followed', 'check the clock'
    ),
    'implausible_points': DropReason(
        'most coordinates are no metres', 'check offsets and datatypes of the fields in the driver'
    ),
    'unmatched': DropReason(
        'too few points to match the scan, and nothing else connects it',
        'is the LiDAR covered, or odometry.min_points too high?',
    ),
    'window_failed': DropReason(
        'the choice of its window raised an exception', 'the log has it once; please report it'
    ),
    'mapper_failed': DropReason(
        'the mapper raised an exception, or no map could be begun', 'the log says why'
    ),
    'before_mend': DropReason(
        'its map was given up for one with mended settings', 'write the setting that the log names'
    ),
    'foreign_frame': DropReason(
        "messages of another frame_id come on the sensor's topic", 'give each sensor its own topic'
    ),
    'unplaced': DropReason(
        'nobody tells where the LiDAR is beside the others', 'set its T_base_sensor'
    ),
    'time_jump': DropReason(
        'stamps went back, and time_jump.policy is ignore', 'reset begins a new map instead'
    ),
    'clock_step': DropReason(
        "its sensor's clock was set while the others' went on",
        'the finding clock_step has the value and the line',
    ),
    'stray_stamp': DropReason('a single stamp that went back', 'check the clock if there are many'),
    'overload': DropReason(
        'scans come faster than they are mapped, and newer ones stood behind it',
        'lower selection.max_candidates; queue.max_delay says how long scans may wait',
    ),
    'queue_full': DropReason(
        'measurements come faster than they are mapped', 'lower selection.max_candidates'
    ),
    'paused': DropReason('the service pause was called'),
    'shutdown': DropReason(
        'it still waited when the time to stop was over', 'raise queue.shutdown_timeout'
    ),
}
"""By the words that drops are counted under."""
