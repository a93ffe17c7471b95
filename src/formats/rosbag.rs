//! ROS 1 bags: events of `dvs_msgs`, `prophesee_event_msgs` and `event_camera_msgs`, pictures of
//! `sensor_msgs`. See [`crate::ros`].

use crate::format::Format;
use crate::ros::{bag, recording, scan};

/// ROS 1 bag.
pub(crate) static FORMAT: Format = Format {
    id: "rosbag",
    name: "ROS 1 bag",
    recognises: |probe| probe.head.starts_with(b"#ROSBAG V") || probe.head.starts_with(b"#ROSRECORD V"),
    open: |path, declared| recording::open(bag::open(path, scan::survey)?, declared),
};
