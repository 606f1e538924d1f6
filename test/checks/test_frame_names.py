"""Frame_ids in messages."""

from incremental_mapper.checks.frame_names import shown_frame
from incremental_mapper.checks.live_inputs import foreign_messages


def test_a_frame_of_thousands_of_characters_leaves_a_message_readable():
    text = foreign_messages('imu', 'imu_link', 20_000 * 'frame', 3).text
    assert "'imu_link'" in text
    assert len(text) < 300


def test_frames_are_shown_as_they_are():
    assert shown_frame('left_lidar') == "'left_lidar'"
    assert shown_frame('') == "'(none)'"
