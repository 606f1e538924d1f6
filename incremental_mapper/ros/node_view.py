"""A running node in Rerun: what its topics tell, from a program of its own."""

import time
from pathlib import Path
from typing import Any

import numpy as np

from incremental_mapper.measurements import NANOSECONDS
from incremental_mapper.results.messages.result_messages import WINDOW_PREFIX, read_status
from incremental_mapper.results.run_view import NUMBERS, POINTS_OF_A_WINDOW, pose_matrix
from incremental_mapper.ros.client import Heard, open_client
from incremental_mapper.ros.publishers import WINDOW_DEPTH, reliable
from incremental_mapper.ros.rclpy_types import message_class
from incremental_mapper.visualization.factor_colours import FACTOR_COLOURS
from incremental_mapper.visualization.rerun_scene import RerunScene

LOOK = 0.2
"""Seconds between two looks whether it is to end."""
SCORE = f'{WINDOW_PREFIX}score'


class NodeView:
    """Logs a node's messages; every method takes one, in the client's thread.

    The node tells the winner's score of a window and how many candidates there were, not the
    others' scores, and of fixes where they are, not how sure they are.
    """

    def __init__(self, scene: RerunScene) -> None:
        self._scene = scene
        self._window = 0
        self._height = 0.0
        self._shows = False  # anything of the map that there is
        self.windows = 0

    def odometry(self, heard: Heard) -> None:
        """Move the car."""
        self._at(heard)
        at, turn = heard.message.pose.pose.position, heard.message.pose.pose.orientation
        self._height = at.z
        place = (at.x, at.y, at.z, turn.x, turn.y, turn.z, turn.w)
        self._scene.car(pose_matrix(np.array(place)))

    def points(self, heard: Heard) -> None:
        """Add a window's points."""
        self._at(heard)
        message = heard.message
        table = np.frombuffer(message.data, dtype='<f4').reshape(-1, message.point_step // 4)
        step = max(-(-len(table) // POINTS_OF_A_WINDOW), 1)
        self._scene.points(table[::step, :3], self._height)

    def path(self, heard: Heard) -> None:
        """Show the way; one without poses says that the map is no more, and another one begins."""
        places = [pose.pose.position for pose in heard.message.poses]
        if not places:
            self._begin_again()
            return
        self._at(heard)
        self._scene.path(np.array([[p.x, p.y, p.z] for p in places]).reshape(-1, 3))

    def graph(self, heard: Heard) -> None:
        """Show the newest part of the graph."""
        markers = {
            marker.ns: np.array([[p.x, p.y, p.z] for p in marker.points]).reshape(-1, 3)
            for marker in heard.message.markers
            if marker.ns
        }
        if not markers:
            return  # it takes away those of a map that is no more, and has no stamp
        self._at_stamp(heard.message.markers[0].header.stamp)
        nothing = np.zeros((0, 3))
        self._scene.graph(
            markers.get('poses', nothing),
            markers.get('clusters', nothing),
            {kind: markers[kind].reshape(-1, 2, 3) for kind in FACTOR_COLOURS if kind in markers},
            markers.get('priors', nothing),
        )

    def stats(self, heard: Heard) -> None:
        """Add a window's numbers."""
        values = read_status(heard.message.status[0])
        window = int(values[f'{WINDOW_PREFIX}window'])
        if window < self._window:  # nobody had heard that the map before is no more
            self._begin_again()
        self._window = window
        self.windows += 1
        self._at(heard)
        names = {name: values.get(f'{WINDOW_PREFIX}{name}') for name in NUMBERS}
        self._scene.numbers({key: float(n) for key, n in names.items() if n is not None})
        if values.get(SCORE) is not None:
            self._scene.winner_score(float(values[SCORE]))

    def _begin_again(self) -> None:
        self._window = 0
        if self._shows:
            self._scene.begin_again()
        self._shows = False

    def _at(self, heard: Heard) -> None:
        self._at_stamp(heard.message.header.stamp)

    def _at_stamp(self, stamp: Any) -> None:
        self._shows = True
        self._scene.at(stamp.sec * NANOSECONDS + stamp.nanosec, self._window)


def show_node(name: str, save: Path | None, domain: int) -> int:
    """Show a node until Ctrl-C.

    Args:
        name: The node's name, with its namespace where it has one.
        save: A file to write to; None opens a viewer.
        domain: The ROS domain.

    Returns:
        Number of windows that were shown.

    Raises:
        InputError: Rerun is not installed, or its viewer does not start.
        OutputError: The file cannot be written.
    """
    scene = RerunScene(save, candidates=False)
    view = NodeView(scene)
    own = name.strip('/')
    window, latched = reliable(WINDOW_DEPTH), reliable(1, latched=True)
    every_window = reliable(WINDOW_DEPTH, latched=True)
    topics = (
        ('odometry', 'nav_msgs/msg/Odometry', view.odometry, window),
        ('map_increment', 'sensor_msgs/msg/PointCloud2', view.points, window),
        ('graph_stats', 'diagnostic_msgs/msg/DiagnosticArray', view.stats, every_window),
        ('path', 'nav_msgs/msg/Path', view.path, latched),
        ('graph', 'visualization_msgs/msg/MarkerArray', view.graph, latched),
    )
    try:
        with open_client(domain, own, local=False) as client:
            for topic, kind, take, quality in topics:
                client.listen(f'/{own}/{topic}', message_class(kind), take, quality)
            while True:
                time.sleep(LOOK)
    except KeyboardInterrupt:
        return view.windows
    finally:
        scene.close()
