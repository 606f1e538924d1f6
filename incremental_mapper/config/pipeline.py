"""Settings of the pipeline: from the windows to the map, for `map` and the node alike."""

from enum import StrEnum
from typing import Self

from pydantic import Field, model_validator

from incremental_mapper.config.sections import Section, Sigma

MOST_SUBMAP_SCANS = 200
"""Upper limit of ``mom.submap_scans``; so many scans are kept for scoring."""


class Strategy(StrEnum):
    """Which candidate a window keeps (paper, section Experimental Setup; ``fewest`` is ours)."""

    MOM = 'mom'
    BASE = 'base'
    MIN_TIME_SHIFT = 'min_time_shift'
    MIN_SOLVER_ERROR = 'min_solver_error'
    FEWEST = 'fewest'


class OdometryMethod(StrEnum):
    """Which library matches consecutive scans."""

    KISS_ICP = 'kiss_icp'
    GICP = 'gicp'


class WindowSettings(Section):
    """How measurements are gathered."""

    duration: float = Field(default=0.1, ge=0.02, le=5.0)
    """Length of a window in seconds."""
    lateness: float = Field(default=0.5, ge=0.0, le=60.0)
    """Seconds that a window waits for a sensor that fell silent."""
    predict: bool = True
    """Node: wait for each sensor no longer than its own period, jitter and lateness so far say.
    `map` waits in full, as the node does without it."""
    max_carry: float = Field(default=1.0, ge=0.0, le=60.0)
    """Seconds for which unconnected measurements are carried before a bridge is built."""


class MatchNoise(StrEnum):
    """Where the noise of a match comes from."""

    HESSIAN = 'hessian'
    CONSTANT = 'constant'


class OdometrySettings(Section):
    """Scan matching between consecutive scans of one LiDAR."""

    method: OdometryMethod = OdometryMethod.GICP
    """Scan matcher: gicp (small_gicp) or kiss_icp."""
    min_range: float = Field(default=2.5, ge=0.0, le=100.0)
    """Points nearer to the sensor than this many metres (the car itself) are left out."""
    max_range: float = Field(default=80.0, gt=0.0, le=1000.0)
    """Points further than this many metres are left out."""
    voxel_size: float = Field(default=0.7, gt=0.0, le=10.0)
    """Down-sampling before gicp; voxel size of the local map for kiss_icp. Metres."""
    max_correspondence: float = Field(default=2.0, gt=0.0, le=50.0)
    """Largest distance of a gicp correspondence in metres."""
    match_range: float = Field(default=80.0, gt=0.0, le=1000.0)
    """Points that are further from base_link in the plane, in metres, are left out by gicp."""
    local_map_scans: int = Field(default=10, ge=1, le=200)
    """gicp target: 1 matches scan to scan, more match to a sliding map of so many scans."""
    min_points: int = Field(default=100, ge=10, le=100_000)
    """A scan with fewer points after down-sampling gets no odometry."""
    min_overlap: float = Field(default=0.7, ge=0.0, le=1.0)
    """A gicp match in which a smaller share of the points finds a partner is rejected."""
    max_gap: float = Field(default=30.0, gt=0.0, le=60.0)
    """Scans of one LiDAR that are further apart in seconds are not matched. Over more than 1 s
    they are where the match is certain: gicp finds it from several sides, and in both
    directions."""
    processes: bool = False
    """Match each LiDAR's scans in a process of its own: the same results, sooner."""
    deskew: bool = True
    """Undo the motion within a sweep where the cloud has per-point time."""
    imu_guess: bool = True
    """Guess where a scan lies to the one before, and deskew it, by the IMU: by its turn, and its
    change of the velocity that matches tell. Over holes in it, where it contradicts the matches,
    and with false, motion goes on as between the scans before."""
    noise: MatchNoise = MatchNoise.HESSIAN
    """hessian gives every match of gicp a covariance of its own, by how well the scans hold it in
    each direction; constant gives all of them the sigmas below, as do those of kiss_icp."""
    covariance_scale: float = Field(default=25.0, gt=0.0, le=1e6)
    """hessian: factor on the least-squares covariance of a match, whose points are not independent
    and whose errors are much alike from scan to scan. Directions that are held weakly have more."""
    floor_translation: Sigma = 0.005
    """hessian: standard deviation in metres that a match has at the least, each axis."""
    floor_rotation: Sigma = 0.0005
    """hessian: the same in radians."""
    sigma_translation: Sigma = 0.03
    """constant: standard deviation of a match in metres, each axis."""
    sigma_rotation: Sigma = 0.003
    """constant: standard deviation of a match in radians, each axis; ties of candidates are judged
    by it as well."""

    @model_validator(mode='after')
    def _check_ranges(self) -> Self:
        if self.min_range >= self.max_range:
            raise ValueError(f'min_range {self.min_range} is not below max_range {self.max_range}')
        return self


class ImuSettings(Section):
    """Noise of the IMU as continuous densities, and how spans are integrated."""

    gravity: float = Field(default=9.81, ge=0.0, le=30.0)
    """Magnitude of gravity in m/s^2; 0 where the IMU's accelerations are without it."""
    accelerometer_noise: Sigma = 0.02
    """m/s^2/sqrt(Hz)."""
    gyroscope_noise: Sigma = 0.001
    """rad/s/sqrt(Hz)."""
    accelerometer_bias_walk: Sigma = 0.001
    """m/s^3/sqrt(Hz)."""
    gyroscope_bias_walk: Sigma = 0.0001
    """rad/s^2/sqrt(Hz)."""
    integration_sigma: Sigma = 0.0001
    """m/sqrt(Hz), uncertainty of the numerical integration of position."""
    max_gap: float = Field(default=0.1, gt=0.0, le=10.0)
    """A span with a longer hole between samples, in seconds, makes no connection."""


class GnssSettings(Section):
    """Which fixes are used and how far they are trusted."""

    min_status: int = Field(default=0, ge=0, le=2)
    """Lowest usable NavSatStatus: 0 fix, 1 SBAS, 2 GBAS (RTK or VRS fixed)."""
    min_sigma: Sigma = 0.05
    """A smaller reported standard deviation is raised to this many metres."""
    max_sigma: Sigma = 10.0
    """Fixes with a larger horizontal standard deviation in metres are not used."""
    default_sigma: Sigma = 2.0
    """Standard deviation in metres where the message has no covariance."""
    robust_threshold: float = Field(default=3.0, ge=0.0, le=100.0)
    """Huber threshold in standard deviations; 0 switches the robust loss off."""
    min_distance: float = Field(default=2.0, gt=0.0, le=1000.0)
    """Travelled metres after which the yaw is taken from the GNSS track."""
    exchanged: bool = False
    """Latitude and longitude are exchanged in the messages."""
    mirrored: bool = False
    """The longitude has the wrong sign in the messages: west for east."""


class DatumSettings(Section):
    """Where the origin of the map lies on the earth, so that sessions share a frame."""

    fixed: bool = False
    """The map is east-north-up around the place below; false takes the first fix that holds."""
    latitude: float = Field(default=0.0, ge=-90.0, le=90.0, allow_inf_nan=False)
    """Latitude of the origin in degrees, north positive."""
    longitude: float = Field(default=0.0, ge=-180.0, le=180.0, allow_inf_nan=False)
    """Longitude of the origin in degrees, east positive."""
    altitude: float = Field(default=0.0, ge=-12_000.0, le=100_000.0, allow_inf_nan=False)
    """Metres above the WGS-84 ellipsoid, or above whatever the fixes count from."""

    @model_validator(mode='after')
    def _check_fixed(self) -> Self:
        if not self.fixed and (self.latitude, self.longitude, self.altitude) != (0.0, 0.0, 0.0):
            raise ValueError('a datum is given, but fixed is false; set datum.fixed: true')
        return self


class GraphSettings(Section):
    """Priors, and how G(t) is solved."""

    lag: float = Field(default=2.0, ge=0.0, le=60.0)
    """Seconds of the newest part of G(t) that still follows new measurements."""
    final_optimization: bool = True
    """Optimise all of G(t) once more before it is saved."""
    motion_compensation: bool = True
    """Move each measurement of a merged cluster to the cluster's stamp by the predicted motion;
    false is the paper's choice."""
    dead_reckoning: bool = True
    """Hold clusters that an IMU span passes over by dead reckoning from its start as well: turns
    from pose to pose are 1.5 to 4 times as exact, at the cost of a factor for each. false leaves
    such clusters to their matches (paper)."""
    bias_period: float = Field(default=1.0, ge=0.0, le=60.0)
    """Seconds of IMU spans that share one bias variable; the next one is tied to it by its random
    walk. 0 gives each end of a span a bias of its own (paper), as the strategy base always does."""
    prior_sigma_position: Sigma = 0.1
    """First pose, metres."""
    prior_sigma_level: Sigma = 0.02
    """First pose, roll and pitch, radians."""
    prior_sigma_yaw: Sigma = 0.3
    """First pose, yaw, radians, once fixes have turned the map. Before, its axes go by that pose,
    which is held as well as it is level."""
    prior_sigma_velocity: Sigma = 10.0
    """First velocity, m/s."""
    prior_sigma_accelerometer_bias: Sigma = 0.05
    """First accelerometer bias, m/s^2."""
    prior_sigma_gyroscope_bias: Sigma = 0.005
    """First gyroscope bias, rad/s."""
    weak_sigma_position: Sigma = 1.0
    """Regularising prior where a chain starts anew or a component is unconnected: metres."""
    weak_sigma_rotation: Sigma = 0.2
    """The same, radians."""
    weak_sigma_velocity: Sigma = 1.0
    """The same, m/s."""
    bridge_speed: float = Field(default=20.0, ge=0.0, le=1000.0)
    """A bridge over a hole in all data is looser by so many metres for each second beyond the
    first: what the vehicle can do unseen."""
    bridge_rate: float = Field(default=0.3, ge=0.0, le=100.0)
    """The same, radians for each second; a bridge never says more than that half a turn is
    possible."""
    max_iterations: int = Field(default=10, ge=1, le=200)
    """Iterations of one local solve."""
    markers_span: float = Field(default=10.0, ge=0.1, le=3600.0)
    """Node: seconds of the newest part of the graph that the markers show."""
    markers_period: float = Field(default=0.5, ge=0.05, le=3600.0)
    """Node: shortest time between two publications of the markers, in seconds."""


class ClosureSettings(Section):
    """Loop closure: places that a drive passes again hold its poses together."""

    enabled: bool = True
    """Look for them before a map is saved, and in a node while it grows."""
    map_length: float = Field(default=20.0, ge=2.0, le=500.0)
    """Metres of way whose scans make one local map; local maps are what is compared."""
    voxel_size: float = Field(default=0.4, ge=0.05, le=5.0)
    """Local maps are thinned to this grid, in metres."""
    max_range: float = Field(default=50.0, ge=5.0, le=1000.0)
    """Points further from base_link than this many metres do not enter local maps."""
    min_travel: float = Field(default=60.0, ge=1.0, le=1e6)
    """Metres of way between two passes of a place at the least: what is nearer, odometry knows."""
    radius: float = Field(default=25.0, ge=0.0, le=10_000.0)
    """Local maps whose poses are so many metres apart or less are compared. Further ones are where
    the extra ``closures`` is installed and they look alike from above."""
    candidates: int = Field(default=2, ge=1, le=1000)
    """Earlier local maps that one is compared with, each by place and by looks."""
    min_overlap: float = Field(default=0.6, ge=0.0, le=1.0)
    """A smaller share of what stands on the ground, seen by both, makes no closure."""
    floor_translation: Sigma = 0.05
    """Standard deviation in metres that a closure has at the least, each axis, since local maps are
    bent themselves."""
    floor_rotation: Sigma = 0.003
    """The same in radians."""
    robust_threshold: float = Field(default=3.0, ge=0.0, le=100.0)
    """Huber threshold in standard deviations; 0 switches the robust loss off."""
    live_period: float = Field(default=10.0, ge=0.0, le=1e6, allow_inf_nan=False)
    """Seconds at the least between two searches of a node, whose map is closed while it grows; 0
    leaves that to what is saved."""


class SelectionSettings(Section):
    """How candidates are enumerated and scored."""

    strategy: str = Strategy.MOM.value
    """mom, base, min_time_shift, min_solver_error, fewest, or a name that was registered."""
    max_candidates: int = Field(default=1000, ge=1, le=1_000_000)
    """A window with more candidates than this is searched instead of enumerated."""
    beam_width: int = Field(default=8, ge=1, le=1000)
    """Prefixes of every length that the search follows (mom, min_solver_error)."""
    time_budget: float = Field(default=0.5, gt=0.0, le=6000.0)
    """Share of a window's duration (``window.duration``) that its search may take to follow
    prefixes; half as much again may go into changing single decisions of the best candidates. With
    0.5 a window that is searched is done before the next one closes."""
    tie_confidence: float = Field(default=0.95, ge=0.0, lt=1.0)
    """Candidates of mom tie unless one is better at this confidence (paired over the query points);
    of those that tie the smallest graph wins whose factors and rotations agree as well. 0 takes the
    lowest score, however small its lead (paper)."""
    join_standing: bool = True
    """While the vehicle stands, by IMU and scan matching together, measurements join the newest
    cluster: they add no variable, and scans no points. false makes clusters of them all the same
    (paper), as the strategy base always does."""
    direct: bool = False
    """Search the neighbourhoods again at every candidate's poses (slow, for verification)."""
    verify: bool = False
    """Score every candidate both ways and report how often the two agree (slow)."""


class MomSettings(Section):
    """The Mutually Orthogonal Metric (paper, section Evaluation Metric)."""

    radius: float = Field(default=1.5, gt=0.0, le=20.0)
    """Radius of a neighbourhood in metres."""
    eigenvalue_ratio: float = Field(default=10.0, ge=1.0, le=1e4)
    """A neighbourhood is planar where the middle eigenvalue is so many times the smallest."""
    min_neighbours: int = Field(default=5, ge=3, le=1000)
    """Smallest neighbourhood."""
    min_family_points: int = Field(default=30, ge=1, le=100_000)
    """A plane family with fewer points does not count."""
    max_points: int = Field(default=200, ge=10, le=100_000)
    """Query points of one window: planar places at which its candidates are judged."""
    max_angle: float = Field(default=0.2, gt=0.0, le=0.7)
    """Largest angle in radians between a normal and its family's axis."""
    voxel_size: float = Field(default=0.8, gt=0.0, le=5.0)
    """Scans are thinned to this grid, in metres, before they are scored."""
    submap_scans: int = Field(default=4, ge=1, le=MOST_SUBMAP_SCANS)
    """Scans of G(t-1) that the new scans are compared with."""


class MapStore(StrEnum):
    """Where the points of a drive's scans are kept."""

    SPILL = 'spill'
    MEMORY = 'memory'
    DISK = 'disk'


class MapSettings(Section):
    """The accumulated map."""

    store: MapStore = MapStore.SPILL
    """spill keeps the scans in memory up to ``memory``, and all further ones in a temporary file:
    5 to 12 GB an hour with two VLP-16. disk keeps all of them there, memory none."""
    memory: float = Field(default=128.0, ge=0.0, le=1e6, allow_inf_nan=False)
    """spill: MB of scans that stay in memory."""
    store_folder: str = ''
    """Folder of that file; empty takes TMPDIR where that is set, else /var/tmp, since /tmp is often
    held in memory."""
    reserve: float = Field(default=2000.0, ge=0.0, le=1e9, allow_inf_nan=False)
    """MB of the disk, of scans or a journal, that are free when a user is told (``disk_low``): at
    KAIST rates a quarter of an hour before it is full."""
    voxel_size: float = Field(default=0.2, gt=0.0, le=10.0)
    """Voxel size of the map in metres."""
    max_range: float = Field(default=60.0, gt=0.0, le=1000.0)
    """Points further from the sensor than this many metres do not enter the map."""
    formats: tuple[str, ...] = ()
    """Formats that a run is saved in besides its own files, such as [laz, gpx]; see ``export``."""
    publish_period: float = Field(default=2.0, ge=0.05, le=3600.0)
    """Node: shortest time between two publications of the map, in seconds."""
    display_points: int = Field(default=1_000_000, ge=0)
    """Node: most points of a published map, those nearest to the newest pose; 0 publishes all."""
    display_radius: float = Field(default=300.0, ge=0.0, le=1e6, allow_inf_nan=False)
    """Node: points of the published map are within so many metres of the newest pose; 0 sets no
    limit."""
    display_voxel_size: float = Field(default=0.0, ge=0.0, le=100.0, allow_inf_nan=False)
    """Node: voxel size of the published map in metres; 0 takes ``map.voxel_size``."""
