"""Copies of another topic's clouds, and clouds of LiDARs that only keep time together."""

import numpy as np
import pytest

from incremental_mapper.checks.cloud_copies import CloudTopic, copied_from

STAMPS = range(0, 1200, 100)
ROOMS = {
    stamp: np.random.default_rng(stamp).uniform(-20, 20, (3000 + stamp, 3)).astype(np.float32)
    for stamp in STAMPS
}


def topic(change, frame='lidar', stamps=STAMPS):
    clouds = {stamp: change(ROOMS[stamp]) for stamp in stamps}
    sizes = {stamp: len(cloud) for stamp, cloud in clouds.items()}
    return CloudTopic(frame, sizes, dict(list(clouds.items())[:3]))


def centroids(cloud):
    cells = np.unique(np.floor(cloud / 0.2), axis=0)
    return (cells + 0.5).astype(np.float32) * 0.2


RAW = topic(lambda cloud: cloud)


@pytest.mark.parametrize(
    'made',
    [
        topic(lambda cloud: cloud[cloud[:, 2] > 0]),
        topic(lambda cloud: cloud[::5]),
        topic(centroids),
        topic(lambda cloud: cloud + np.float32(0.02)),
        topic(lambda cloud: cloud),
        topic(lambda cloud: cloud + 7.0, frame='base_link'),
        topic(lambda cloud: cloud[::5], stamps=list(STAMPS)[1:]),
    ],
    ids=['cropped', 'thinned', 'voxels', 'de-skewed', 'same', 'moved', 'later'],
)
def test_what_was_made_of_a_cloud_is_a_copy(made):
    assert copied_from({'/raw': RAW, '/made': made}) == {'/made': '/raw'}


@pytest.mark.parametrize(
    'other',
    [
        topic(lambda cloud: cloud[::5] + 3.0),
        topic(lambda cloud: cloud[:2900] + 3.0, frame='other'),
        topic(lambda cloud: cloud[::5], frame='other'),
        CloudTopic('lidar', {at + 37: size for at, size in RAW.sizes.items()}, RAW.clouds),
        CloudTopic('lidar', {}, {}),
    ],
    ids=['synchronised', 'constant size', 'own frame', 'own stamps', 'nothing'],
)
def test_lidars_of_their_own_are_none(other):
    assert copied_from({'/raw': RAW, '/other': other}) == {}


def test_an_original_is_no_copy():
    thin, thinner = topic(lambda cloud: cloud[::2]), topic(lambda cloud: cloud[::4])
    found = copied_from({'/thinner': thinner, '/raw': RAW, '/thin': thin})
    assert found == {'/thin': '/raw', '/thinner': '/raw'}
