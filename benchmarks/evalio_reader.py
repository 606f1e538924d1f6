"""A pipeline of evalio that does nothing: what a run takes without one."""

from collections.abc import Mapping
from typing import Any

from evalio.pipelines import Pipeline
from evalio.types import SE3, ImuMeasurement, ImuParams, LidarMeasurement, LidarParams, Point


class Reading(Pipeline):  # type: ignore[misc]
    """Takes everything and says nothing."""

    @staticmethod
    def name() -> str:
        """Name of the pipeline."""
        return 'reading'

    @staticmethod
    def version() -> str:
        """It has none."""
        return '0'

    @staticmethod
    def url() -> str:
        """Nor an address."""
        return ''

    @staticmethod
    def default_params() -> dict[str, bool | int | float | str]:
        """Nothing can be set."""
        return {}

    def set_params(self, params: Mapping[str, Any]) -> dict[str, Any]:
        """All are unknown."""
        return dict(params)

    def set_imu_params(self, params: ImuParams) -> None:
        """Of no use."""

    def set_lidar_params(self, params: LidarParams) -> None:
        """Of no use."""

    def set_imu_T_lidar(self, T: SE3) -> None:  # noqa: N802, N803 (evalio's names)
        """Of no use."""

    def set_visualizing(self, visualize: Any) -> None:
        """There is nothing to see."""

    def initialize(self) -> None:
        """Nothing to begin."""

    def map(self) -> dict[str, list[Point]]:
        """None."""
        return {}

    def add_imu(self, mm: ImuMeasurement) -> None:
        """Let go."""

    def add_lidar(self, mm: LidarMeasurement) -> None:
        """Let go."""
