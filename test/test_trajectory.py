"""Trajectories: exact stamps through files, interpolation, and lines that are no poses."""

from decimal import Decimal

import gtsam
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from incremental_mapper.errors import InputError
from incremental_mapper.trajectory import (
    Trajectory,
    fit_rigid,
    from_matrices,
    read_tum,
    write_tum,
)

SECOND = 1_000_000_000
EPOCH = 1_544_676_777_123_456_789

any_stamp = st.integers(-(2**63), 2**63 - 1) | st.integers(EPOCH, EPOCH + 1000)
stamp_lists = st.lists(any_stamp, min_size=1, max_size=6, unique=True)


def turned(stamps, positions, yaws):
    return Trajectory(
        np.array(stamps, dtype=np.int64),
        np.array(positions, dtype=float),
        Rotation.from_euler('z', np.array(yaws)[:, None]).as_quat().reshape(-1, 4),
    )


@given(stamp_lists, st.integers(0, 1000))
def test_stamps_keep_every_nanosecond_through_a_file(tmp_path_factory, stamps, seed):
    rng = np.random.default_rng(seed)
    count = len(stamps)
    path = tmp_path_factory.mktemp('tum') / 'trajectory.tum'
    written = Trajectory(
        np.array(sorted(stamps), dtype=np.int64),
        rng.normal(scale=1000, size=(count, 3)),
        Rotation.random(count, rng=rng).as_quat(),
    )
    write_tum(path, written)
    read = read_tum(path)
    assert read.stamps.tolist() == sorted(stamps)
    # Nine decimals are written.
    assert read.positions == pytest.approx(written.positions, abs=1e-9)
    assert read.quaternions == pytest.approx(written.quaternions, abs=3e-9)


def test_position_is_interpolated_linearly_and_rotation_by_the_angle():
    track = turned(
        [EPOCH, EPOCH + SECOND, EPOCH + 3 * SECOND],
        [[0, 0, 0], [4, 0, 2], [4, 6, 2]],
        [0.0, 1.0, -1.0],
    )
    at = track.interpolate(np.array([EPOCH + SECOND // 4, EPOCH + 2 * SECOND]))
    assert at.positions == pytest.approx(np.array([[1, 0, 0.5], [4, 3, 2]]), abs=1e-9)
    yaws = at.rotations().as_euler('zyx')[:, 0]
    assert yaws == pytest.approx([0.25, 0.0], abs=1e-9)


def test_rotation_is_interpolated_the_short_way_round():
    track = turned([0, SECOND], np.zeros((2, 3)), [np.pi - 0.1, -np.pi + 0.1])
    middle = track.interpolate(np.array([SECOND // 2])).rotations().as_matrix()[0]
    assert middle == pytest.approx(Rotation.from_euler('z', np.pi).as_matrix(), abs=1e-9)


def test_interpolation_at_its_own_stamps_changes_nothing():
    stamps = EPOCH + np.array([0, 1, 17, SECOND])
    track = turned(stamps, np.arange(12).reshape(4, 3), [0.1, 0.2, 0.3, 0.4])
    same = track.interpolate(track.stamps)
    assert same.positions == pytest.approx(track.positions, abs=1e-12)
    assert same.matrices() == pytest.approx(track.matrices(), abs=1e-9)


def test_stamp_outside_is_not_extrapolated():
    track = turned([10, 20], np.zeros((2, 3)), [0, 0])
    stamps = np.array([9, 10, 15, 20, 21])
    assert track.covers(stamps).tolist() == [False, True, True, True, False]
    for stamp in (9, 21):
        with pytest.raises(ValueError, match='outside'):
            track.interpolate(np.array([stamp]))


def test_trajectory_of_one_pose_covers_its_own_stamp_only():
    track = turned([10], [[1, 2, 3]], [0.5])
    assert track.interpolate(np.array([10, 10])).positions.tolist() == [[1, 2, 3]] * 2
    assert track.covers(np.array([9, 10, 11])).tolist() == [False, True, False]


def test_empty_trajectory_covers_nothing():
    empty = from_matrices(np.zeros(0, dtype=np.int64), np.zeros((0, 4, 4)))
    assert len(empty) == 0
    assert empty.covers(np.array([1])).tolist() == [False]
    assert len(empty.interpolate(np.zeros(0, dtype=np.int64))) == 0


def test_matrices_there_and_back_in_order_of_stamps():
    track = turned([3, 7, 9], [[1, 0, 0], [2, 0, 0], [3, 0, 0]], [0.1, 0.2, 0.3])
    order = [2, 0, 1]
    mended = from_matrices(track.stamps[order], track.matrices()[order])
    assert mended.stamps.tolist() == [3, 7, 9]
    assert mended.matrices() == pytest.approx(track.matrices(), abs=1e-12)


def read_stamps(folder, texts):
    path = folder / 'stamps.tum'
    path.write_text(''.join(f'{text} 0 0 0 0 0 0 1\n' for text in texts))
    return read_tum(path).stamps.tolist()


def notations(stamp, zeros):
    """Ways in which programs write the seconds of a stamp."""
    exact = Decimal(stamp).scaleb(-9)
    digits = str(abs(stamp))
    sign = '-' if stamp < 0 else ''
    yield f'{exact:f}'
    yield f'{exact:f}' + '0' * zeros
    yield f'{exact:e}'
    yield f'{exact:E}'
    yield f'{sign}{digits}e-9'
    yield f'{sign}0.{digits}e+{len(digits) - 9}' if len(digits) >= 9 else f'{sign}{digits}E-009'
    yield f'{sign}{digits[0]}.{digits[1:]}{"0" * zeros}e{len(digits) - 10:+03d}'


@given(any_stamp, st.integers(1, 40))
def test_stamp_is_read_exactly_in_every_notation(tmp_path_factory, stamp, zeros):
    folder = tmp_path_factory.mktemp('notations')
    for text in notations(stamp, zeros):
        assert read_stamps(folder, [text]) == [stamp], text


@given(st.integers(-(2**62), 2**62), st.integers(-499, 499))
def test_stamp_is_rounded_to_the_nearest_nanosecond(tmp_path_factory, stamp, thousandths):
    seconds = (Decimal(stamp) + Decimal(thousandths).scaleb(-3)).scaleb(-9)
    folder = tmp_path_factory.mktemp('rounded')
    for text in (f'{seconds:f}', f'{seconds:e}'):
        assert read_stamps(folder, [text]) == [stamp], text


def test_stamps_are_read_as_numpy_writes_them(tmp_path):
    # evo writes its files so; doubles of today resolve 0.24 us.
    seconds = [1_544_581_130.9, 1_544_581_131.0, 1_544_581_131.1]
    path = tmp_path / 'numpy.tum'
    np.savetxt(path, np.column_stack([seconds, np.tile([0, 0, 0, 0, 0, 0, 1], (3, 1))]))
    assert 'e+09' in path.read_text()
    wanted = [1_544_581_130_900_000_000 + i * 100_000_000 for i in range(3)]
    assert read_tum(path).stamps.tolist() == pytest.approx(wanted, rel=0, abs=120)


def test_negative_stamps_keep_their_order(tmp_path):
    texts = ['0.5', '-0.25', '-1.75', '-0', '-2e-9']
    assert read_stamps(tmp_path, texts) == [-1_750_000_000, -250_000_000, -2, 0, 500_000_000]


@pytest.mark.parametrize(
    'line',
    [
        '1.5 1 2 3 0 0 0',
        '1.5 1 2 3 0 0 0 1 9',
        '1.5 1 2 drei 0 0 0 1',
        'soon 1 2 3 0 0 0 1',
        '1.5 1 nan 3 0 0 0 1',
        '1.5 1 2 3 0 0 0 0',
        '1.5,1,2,3,0,0,0,1',
        'nan 1 2 3 0 0 0 1',
        '-inf 1 2 3 0 0 0 1',
        '9223372036.854775808 1 2 3 0 0 0 1',
        '-9.223372036854775809e9 1 2 3 0 0 0 1',
        '1e999999999 1 2 3 0 0 0 1',
        '1544676777123456789 1 2 3 0 0 0 1',
    ],
)
def test_malformed_line_is_named_with_its_number_and_content(tmp_path, line):
    path = tmp_path / 'bad.tum'
    path.write_text(f'# stamp x y z qx qy qz qw\n1.0 0 0 0 0 0 0 1\n{line}\n')
    with pytest.raises(InputError) as caught:
        read_tum(path)
    assert str(path) in str(caught.value)
    assert 'line 3' in str(caught.value)
    assert line in str(caught.value)


def test_stamp_in_nanoseconds_is_refused_with_the_reason(tmp_path):
    with pytest.raises(InputError, match='stamp in seconds'):
        read_stamps(tmp_path, [EPOCH])


def test_comments_empty_lines_and_short_stamps_are_read(tmp_path):
    path = tmp_path / 'loose.tum'
    path.write_text('# comment\n\n5 1 2 3 0 0 0 2\n4.25 0 0 0 0 0 0 1\n')
    track = read_tum(path)
    assert track.stamps.tolist() == [4_250_000_000, 5_000_000_000]
    assert track.quaternions[1].tolist() == [0, 0, 0, 1]


@pytest.mark.parametrize('text', ['', '# nothing here\n'])
def test_file_without_a_pose_is_rejected(tmp_path, text):
    path = tmp_path / 'none.tum'
    path.write_text(text)
    with pytest.raises(InputError, match='holds no pose'):
        read_tum(path)


def test_missing_and_binary_files_are_named(tmp_path):
    binary = tmp_path / 'cloud.bin'
    binary.write_bytes(bytes(range(128, 256)))
    for path in (tmp_path / 'gone.tum', binary):
        with pytest.raises(InputError, match='cannot be read') as caught:
            read_tum(path)
        assert str(path) in str(caught.value)


@given(st.integers(0, 10_000), st.integers(4, 60), st.sampled_from([0.0, 0.1, 30.0]))
def test_rigid_fit_is_the_one_of_gtsam(seed, count, noise):
    rng = np.random.default_rng(seed)
    points = rng.normal(scale=50.0, size=(count, 3))
    pose = gtsam.Pose3.Expmap(rng.normal(size=6)).matrix()
    targets = points @ pose[:3, :3].T + pose[:3, 3] + rng.normal(scale=noise, size=points.shape)
    wanted = gtsam.Pose3.Align(np.asfortranarray(targets.T), np.asfortranarray(points.T))
    assert fit_rigid(points, targets) == pytest.approx(wanted.matrix(), abs=1e-9)


@given(st.integers(0, 10_000), st.sampled_from(['one', 'two', 'coincident', 'line']))
def test_rigid_fit_leaves_no_error_where_many_fit(seed, kind):
    rng = np.random.default_rng(seed)
    points = rng.normal(scale=50.0, size=({'one': 1, 'two': 2}.get(kind, 9), 3))
    if kind == 'coincident':
        points[:] = points[0]
    elif kind == 'line':
        points = points[0] + np.outer(np.arange(9.0), points[1])
    pose = gtsam.Pose3.Expmap(rng.normal(size=6)).matrix()
    targets = points @ pose[:3, :3].T + pose[:3, 3]
    fitted = fit_rigid(points, targets)
    assert points @ fitted[:3, :3].T + fitted[:3, 3] == pytest.approx(targets, abs=1e-8)
    assert fitted[:3, :3] @ fitted[:3, :3].T == pytest.approx(np.eye(3), abs=1e-12)
    assert np.linalg.det(fitted[:3, :3]) == pytest.approx(1.0)
