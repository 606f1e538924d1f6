"""Types of messages that vendors have for a sensor, and what makes the standard type of them."""

from collections.abc import Mapping

LIDAR_CONVERTERS = {
    'velodyne_msgs/msg/VelodyneScan': 'velodyne_pointcloud (velodyne_transform_node)',
    'ouster_ros/msg/PacketMsg': 'ouster_ros (os_cloud)',
    'ouster_sensor_msgs/msg/PacketMsg': 'ouster_ros (os_cloud)',
    'ouster_msgs/msg/PacketMsg': 'ros2_ouster_drivers',
    'hesai_ros_driver/msg/UdpFrame': 'hesai_ros_driver (source_type: rosbag packets)',
    'hesai_lidar/msg/PandarScan': 'hesai_lidar (data_type: rosbag)',
    'pandar_msgs/msg/PandarScan': 'nebula_ros',
    'nebula_msgs/msg/NebulaPackets': 'nebula_ros',
    'rslidar_msg/msg/RslidarPacket': 'rslidar_sdk (msg_source: 2)',
    'rslidar_msgs/msg/RslidarScan': 'rslidar_sdk (msg_source: 2)',
    'livox_ros_driver/msg/CustomMsg': 'livox_ros_driver (xfer_format: 0)',
    'livox_ros_driver2/msg/CustomMsg': 'livox_ros_driver2 (xfer_format: 0)',
    'livox_interfaces/msg/CustomMsg': 'livox_ros2_driver (xfer_format: 0)',
}
"""Types that LiDARs of a vendor have, and what makes clouds of them; bags with Livox's are read."""
FIX_CONVERTERS = {
    'nmea_msgs/msg/Sentence': 'nmea_navsat_driver (nmea_topic_driver)',
    'gps_msgs/msg/GPSFix': 'gps_tools (fix_translator)',
    'gps_common/msg/GPSFix': 'gps_common (fix_translator)',
    'ublox_msgs/msg/NavPVT': 'ublox_gps, which publishes fix beside it,',
    'ublox_ubx_msgs/msg/UBXNavHPPosLLH': 'ublox_dgnss (ublox_nav_sat_fix_hp_node)',
    'septentrio_gnss_driver/msg/PVTGeodetic': 'septentrio_gnss_driver (publish.navsatfix)',
    'novatel_oem7_msgs/msg/BESTPOS': 'novatel_oem7_driver, which publishes fix beside it,',
    'novatel_gps_msgs/msg/NovatelPosition': 'novatel_gps_driver, which publishes fix beside it,',
    'sbg_driver/msg/SbgGpsPos': 'sbg_driver (output.ros_standard)',
}
"""The same of receivers, for NavSatFix."""
IMU_CONVERTERS = {
    'vectornav_msgs/msg/CommonGroup': 'vectornav (vn_sensor_msgs)',
    'septentrio_gnss_driver/msg/ExtSensorMeas': 'septentrio_gnss_driver (publish.imu)',
    'novatel_oem7_msgs/msg/CORRIMU': 'novatel_oem7_driver, which publishes imu/data beside it,',
    'sbg_driver/msg/SbgImuData': 'sbg_driver (output.ros_standard)',
}
"""The same of IMUs, for Imu."""
SCAN_CONVERTERS = {
    'sensor_msgs/msg/LaserScan': 'laser_geometry or pointcloud_to_laserscan '
    '(laserscan_to_pointcloud)',
    'sensor_msgs/msg/PointCloud': 'point_cloud_converter',
}
"""Standard messages of LiDARs that are no PointCloud2."""
STANDARD = {'imu': ('Imu', IMU_CONVERTERS), 'gnss': ('NavSatFix', FIX_CONVERTERS)}
"""Of each sensor but LiDARs the name of the standard type, and who makes it."""


def made_by(sensor: str) -> Mapping[str, str]:
    """What makes messages that are read, by the type of those that are not."""
    return STANDARD[sensor][1] if sensor in STANDARD else {**LIDAR_CONVERTERS, **SCAN_CONVERTERS}
