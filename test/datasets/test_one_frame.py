"""Two receivers on one topic, and one whose frame_id is renamed."""

from incremental_mapper.datasets.one_frame import OneFrame

SECOND = 10**9


def test_a_second_receiver_between_the_fixes_of_the_first_is_left_out():
    frames = OneFrame()
    assert all(frames.take('gnss', 'front', at * SECOND) for at in range(3))
    assert not frames.take('gnss', 'rear', 2 * SECOND + 5)
    assert frames.take('gnss', 'front', 3 * SECOND)
    assert frames.drops == {('gnss', 'foreign_frame'): 1}
    (found,) = frames.findings()
    assert found.rule == 'foreign_frame' and found.sensor == 'gnss'
    assert "'rear'" in found.text and "'front'" in found.text


def test_a_frame_that_is_renamed_is_the_sensor_again_after_a_while():
    frames = OneFrame()
    assert frames.take('imu', 'imu', 0)
    assert not frames.take('imu', 'imu_link', 2 * SECOND)
    assert frames.take('imu', 'imu_link', 6 * SECOND)
    assert frames.take('imu', 'imu_link', 6 * SECOND + 1)
    assert frames.drops == {('imu', 'foreign_frame'): 1}


def test_each_sensor_has_a_frame_of_its_own():
    frames = OneFrame()
    assert frames.take('imu', 'imu', 0) and frames.take('gnss', 'gnss', 0)
    assert not frames.findings() and not frames.drops


def test_a_first_message_that_is_a_stray_one_does_not_take_the_sensor():
    frames = OneFrame()
    assert frames.take('imu', 'stray', 0)
    passed = [frames.take('imu', 'imu', at) for at in range(1, 101)]
    assert passed == [False] * 2 + [True] * 98
    assert not frames.take('imu', 'stray', 101)
    assert all(
        frames.take('gnss', 'front', at) and not frames.take('gnss', 'rear', at + 1)
        for at in range(0, 40, 2)
    ), 'two of one rate: the first stays'
