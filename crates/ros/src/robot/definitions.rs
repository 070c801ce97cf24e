//! The vendored message definitions of the robots' two types, combined as publishers send them.

use super::super::message::md5sum;

/// Type of the odometry.
pub const ODOMETRY: &str = "nav_msgs/Odometry";

/// Type of the pictures.
pub const COMPRESSED_IMAGE: &str = "sensor_msgs/CompressedImage";

const HEADER: (&str, &str) = ("std_msgs/Header", include_str!("../msg/Header.msg"));

/// The full definition of `nav_msgs/Odometry`.
pub fn odometry_definition() -> String {
    let nested = [
        HEADER,
        ("geometry_msgs/PoseWithCovariance", include_str!("../msg/PoseWithCovariance.msg")),
        ("geometry_msgs/Pose", include_str!("../msg/Pose.msg")),
        ("geometry_msgs/Point", include_str!("../msg/Point.msg")),
        ("geometry_msgs/Quaternion", include_str!("../msg/Quaternion.msg")),
        ("geometry_msgs/TwistWithCovariance", include_str!("../msg/TwistWithCovariance.msg")),
        ("geometry_msgs/Twist", include_str!("../msg/Twist.msg")),
        ("geometry_msgs/Vector3", include_str!("../msg/Vector3.msg")),
    ];
    assemble(include_str!("../msg/Odometry.msg"), &nested)
}

/// The full definition of `sensor_msgs/CompressedImage`.
pub fn compressed_image_definition() -> String {
    assemble(include_str!("../msg/CompressedImage.msg"), &[HEADER])
}

fn assemble(root: &str, nested: &[(&str, &str)]) -> String {
    let rule = "=".repeat(80);
    let sections = nested.iter().map(|(name, text)| format!("\n{rule}\nMSG: {name}\n{text}"));
    std::iter::once(root.to_owned()).chain(sections).collect()
}

/// The md5sum of a definition of ours.
pub(super) fn sum_of(type_name: &str, definition: &str) -> String {
    md5sum(type_name, definition).unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_md5sums_are_those_of_ros() {
        assert_eq!(sum_of(ODOMETRY, &odometry_definition()), "cd5e73d190d741a2f92e81eda573aca7");
        assert_eq!(sum_of(COMPRESSED_IMAGE, &compressed_image_definition()), "8f7a12909da2c9d3332d540a0977563f");
    }
}
