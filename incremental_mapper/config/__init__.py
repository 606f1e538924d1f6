"""The settings: one schema that the command line and the node share; files are ``settings``."""

from collections.abc import Mapping
from typing import Annotated, Any, TypeAlias

from pydantic import BeforeValidator, Field

from incremental_mapper.config.live import (
    DiagnosticsSettings,
    FrameSettings,
    ImuOdometrySettings,
    JournalSettings,
    PathSettings,
    QueueSettings,
    SaveSettings,
    SessionSettings,
    TfMode,
    TfSettings,
    TimeJumpPolicy,
    TimeJumpSettings,
)
from incremental_mapper.config.pipeline import (
    MOST_SUBMAP_SCANS,
    ClosureSettings,
    DatumSettings,
    GnssSettings,
    GraphSettings,
    ImuSettings,
    MapSettings,
    MapStore,
    MatchNoise,
    MomSettings,
    OdometryMethod,
    OdometrySettings,
    SelectionSettings,
    Strategy,
    WindowSettings,
)
from incremental_mapper.config.sections import Section
from incremental_mapper.config.sensors import (
    MOST_OFFSET,
    Imu,
    LidarSensor,
    Sensor,
)

__all__ = [
    'MOST_OFFSET',
    'MOST_SUBMAP_SCANS',
    'ClosureSettings',
    'Config',
    'DatumSettings',
    'DiagnosticsSettings',
    'FrameSettings',
    'GnssSettings',
    'GraphSettings',
    'Imu',
    'ImuOdometrySettings',
    'ImuSettings',
    'JournalSettings',
    'LidarSensor',
    'Lidars',
    'MapSettings',
    'MapStore',
    'MatchNoise',
    'MomSettings',
    'OdometryMethod',
    'OdometrySettings',
    'PathSettings',
    'QueueSettings',
    'SaveSettings',
    'Section',
    'SelectionSettings',
    'Sensor',
    'SessionSettings',
    'Strategy',
    'TfMode',
    'TfSettings',
    'TimeJumpPolicy',
    'TimeJumpSettings',
    'Tree',
    'WindowSettings',
]

Tree: TypeAlias = dict[str, Any]


def _lidar_sections(value: object) -> object:
    """Turn ``{names: [left], left: {...}}``, the form ROS parameters allow, into a dictionary."""
    if not isinstance(value, Mapping) or 'names' not in value:
        return value
    names = value['names']
    if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
        raise ValueError(f'names is {names!r}; expected a list of LiDAR names')
    unlisted = sorted(set(value) - {'names'} - set(names))
    if unlisted:
        raise ValueError(f'section {unlisted[0]!r} is not in names {names}')
    return {name: value.get(name, {}) for name in names}


Lidars: TypeAlias = Annotated[dict[str, LidarSensor], BeforeValidator(_lidar_sections)]


class Config(Section):
    """All settings."""

    lidars: Lidars = Field(default_factory=dict)
    """LiDARs by name; in YAML ``names`` lists them and each has a section of its own."""
    imu: Imu = Imu()
    """The IMU."""
    gnss: Sensor = Sensor()
    """The GNSS antenna; its translation is the lever arm."""
    window: WindowSettings = WindowSettings()
    odometry: OdometrySettings = OdometrySettings()
    preintegration: ImuSettings = ImuSettings()
    fixes: GnssSettings = GnssSettings()
    datum: DatumSettings = DatumSettings()
    graph: GraphSettings = GraphSettings()
    closure: ClosureSettings = ClosureSettings()
    selection: SelectionSettings = SelectionSettings()
    mom: MomSettings = MomSettings()
    map: MapSettings = MapSettings()
    path: PathSettings = PathSettings()
    frames: FrameSettings = FrameSettings()
    tf: TfSettings = TfSettings()
    imu_odometry: ImuOdometrySettings = ImuOdometrySettings()
    save: SaveSettings = SaveSettings()
    journal: JournalSettings = JournalSettings()
    session: SessionSettings = SessionSettings()
    time_jump: TimeJumpSettings = TimeJumpSettings()
    queue: QueueSettings = QueueSettings()
    diagnostics: DiagnosticsSettings = DiagnosticsSettings()
